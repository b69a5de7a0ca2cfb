"""The directions in which a rig may depart from its model: one or more for each effect that can be named."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.fit import Worker
from ehls_ros.diagnosis.hypotheses import Candidate, candidates
from ehls_ros.physics.rig import Rig


class Direction(NamedTuple):
    """A departure from the given model, of a fixed size.

    Attributes:
        cause: the effect in one of its forms.
        parameter: the parameter that departs; of a direction in which several do, the first.
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
        """What tells the direction from all others."""
        return f"{self.cause.name}/{self.cause.number}/{self.parameter}"

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        return self.cause.units[self._index]

    @property
    def step(self) -> float:
        """Size of the departure, in the parameter's unit."""
        return float(self.values[self._index] - self.cause.neutral[self._index])

    @property
    def smooth(self) -> bool:
        """Whether the model changes in proportion to the departure where that is small."""
        return not len(_nonneutral(self.cause))

    @property
    def _index(self) -> int:
        return self.cause.free.index(self.parameter)

    def rig(self, rig: Rig) -> Rig:
        """Return a rig that departs in this direction."""
        return rig.with_effects((self.cause.use(self.values),))


def directions(evidence: Evidence) -> tuple[Direction, ...]:
    """Return the directions that a recording tells anything of.

    A departure has the size that the fits of a diagnosis take for their derivatives, or the smallest one that they start from
    where the model does not change smoothly.

    Args:
        evidence: a recording compared with the model; one that moves the rig as it will run later.
    """
    worker = Worker(evidence)
    found, _ = candidates(evidence.record, evidence.rig, ())
    return tuple(direction for cause in found if not cause.parts_mass for direction in _of(cause, worker))


def _of(cause: Candidate, worker: Worker) -> Iterator[Direction]:
    away = _nonneutral(cause)
    if len(away):
        near = away[np.argmin(np.sum(np.abs(away - cause.neutral), axis=1))]
        moved = int(np.argmax(near != cause.neutral))
        yield Direction(cause, cause.free[moved], near)
        return
    fit = worker.linearise((cause,), cause.neutral)
    for index, parameter in enumerate(cause.free):
        if np.any(fit.jacobian[:, index : index + 1]):
            values = cause.neutral.copy()
            step = float(fit.steps[index])
            values[index] += step if values[index] + step <= cause.upper[index] else -step
            yield Direction(cause, parameter, values)


def _nonneutral(cause: Candidate) -> Array:
    """Return the starting values of a cause other than the neutral ones, shape (starts, p)."""
    rows: Array = cause.starts[np.any(cause.starts != cause.neutral, axis=1)]
    return rows
