"""Directions in which a rig may depart from its model: one or more per effect."""

import math
from collections.abc import Container, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Worker
from ehls_ros.diagnosis.hypotheses import Candidate, candidates, extended
from ehls_ros.diagnosis.stages import Channel, Comparison
from ehls_ros.physics.rig import Rig


class Direction(NamedTuple):
    """A departure from the given model, of a fixed size.

    Attributes:
        cause: the effect in one of its forms.
        parameter: the parameter that departs; the first of them if several do.
        values: the free parameters at this size, shape (p,).
    """

    cause: Candidate
    parameter: str
    values: Array

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.cause.name

    @property
    def key(self) -> str:
        """Unique key of the direction."""
        return f"{self.cause.name}/{self.cause.number}/{self.parameter}"

    @property
    def step(self) -> float:
        """Size of the departure, in the parameter's unit."""
        return float(self.values[self._index] - self.cause.neutral[self._index])

    @property
    def smooth(self) -> bool:
        """Whether the model changes in proportion to small departures."""
        return not len(_nonneutral(self.cause))

    @property
    def _index(self) -> int:
        return self.cause.free.index(self.parameter)

    def rig(self, rig: Rig) -> Rig:
        """Return the rig with this departure from its present state."""
        return extended(rig, (self.cause,), self.values)


def directions(evidence: Evidence, always: Container[tuple[str, str]] = ()) -> tuple[Direction, ...]:
    """Return the directions observable in a recording, one per parameter of an effect.

    A departure has the size of the difference steps of a diagnosis' fits, or their smallest start if the model does not change
    smoothly. A parameter of several forms departs in the first of them. Of directions with nearly collinear changes of the
    residuals, one suffices to detect a change; a diagnosis then distinguishes between them.

    Args:
        evidence: a recording compared with the model, with motion typical of later operation.
        always: effects and parameters to keep even if collinear with others.
    """
    worker = Worker(evidence)
    found, _ = candidates(evidence.record, evidence.rig, ())
    out = dict[tuple[str, str], Direction]()
    for cause in found:
        if not cause.parts_mass and all((cause.name, parameter) not in out for parameter in cause.free):
            out |= {(d.name, d.parameter): d for d in _of(cause, worker)}
    ordered = sorted(out, key=lambda key: key not in always)
    return tuple(_distinct(worker, [out[key] for key in ordered], sum(key in always for key in ordered)))


def changes(comparison: Comparison, evidence: Evidence, direction: Direction) -> dict[Channel, Array]:
    """Return the change of the whitened residuals in each channel affected by a departure.

    Args:
        comparison: of the evidence's record.
        evidence: the recording compared with the model.
        direction: the departure.
    """
    base = evidence.base.values
    other = evidence.residuals(comparison, direction.rig(evidence.rig)).values
    return {c: other[c] - base[c] for c in evidence.channels if other[c] is not base[c]}


def remainders(evidence: Evidence, found: Sequence[Direction]) -> Array:
    """Return the largest remainder beyond noise in the channels affected by each departure, shape (directions,).

    Args:
        evidence: a recording of the healthy rig compared with the model.
        found: the departures.

    Returns:
        The rms of these remainders, as fractions of the largest term of the channel's balance.
    """
    left = {}
    for c in evidence.channels:
        whole, noise = evidence.nrmse(c, evidence.base.values[c]), evidence.noise_nrmse(c)
        left[c] = math.sqrt(max(whole**2 - noise**2, 0.0))
    comparison = evidence.comparison()
    return np.array([max((left[c] for c in changes(comparison, evidence, d)), default=0.0) for d in found])


def _distinct(worker: Worker, found: Sequence[Direction], always: int) -> Iterator[Direction]:
    """Yield the directions that change anything and are not collinear with earlier ones; the first ``always`` may be."""
    kept = list[dict[Channel, Array]]()
    for number, direction in enumerate(found):
        moved = changes(worker.comparison, worker.evidence, direction)
        length = math.sqrt(sum(float(m @ m) for m in moved.values()))
        if not 0.0 < length < math.inf:
            continue
        unit = {c: m / length for c, m in moved.items()}
        similarities = (abs(sum(float(unit[c] @ other[c]) for c in unit if c in other)) for other in kept)
        if number < always or max(similarities, default=0.0) < rules.ALIKE:
            kept.append(unit)
            yield direction


def _of(cause: Candidate, worker: Worker) -> Iterator[Direction]:
    away = _nonneutral(cause)
    if len(away):
        near = away[np.argmin(np.sum(np.abs(away - cause.neutral), axis=1))]
        moved = int(np.argmax(near != cause.neutral))
        yield Direction(cause, cause.free[moved], near)
        return
    fit = worker.linearise((cause,), cause.neutral)
    for index, parameter in enumerate(cause.free):
        if fit.jacobian.size and np.any(fit.jacobian[:, index]):
            values = cause.neutral.copy()
            step = float(fit.steps[index])
            values[index] += step if values[index] + step <= cause.upper[index] else -step
            yield Direction(cause, parameter, values)


def _nonneutral(cause: Candidate) -> Array:
    """Return the non-neutral starting values of a cause, shape (starts, p)."""
    rows: Array = cause.starts[np.any(cause.starts != cause.neutral, axis=1)]
    return rows
