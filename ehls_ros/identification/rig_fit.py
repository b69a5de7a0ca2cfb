"""Fit of a rig's coefficients to the residuals of all stages of its recordings."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Evidence, Residuals, whitened_slopes
from ehls_ros.diagnosis.loss import gauss_newton, linear_loss, loss
from ehls_ros.diagnosis.noise import deviations, with_noise
from ehls_ros.diagnosis.stages import Channel, Comparison
from ehls_ros.duals import Dual
from ehls_ros.identification.rig_coefficients import Coefficient, model_at
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import GAUSS

LONGEST_MOVE = 1.0
"""Largest change of a logarithmic coordinate in one step."""

CONVERGED, CONVERGED_FRACTION = 0.01, 1e-6
"""Decrease of the loss below which a fit has converged [nats], and the same as a fraction of the loss."""

STEADY_SCALE = 0.02
"""Relative change of a channel's scale below which it has converged."""

DAMPING, DAMPINGS = 1e-8, (1e-8, 1e-4, 1e-2, 1.0, 100.0)
"""Levenberg damping of a first step, and dampings tried in sequence."""

FEWEST_CLUSTERS, SHORTEST_CLUSTER, LONGEST_CLUSTER = 90, 0.4, 2.5
"""Stretches that count as independent: approximate number, and shortest and longest duration [s]."""


class Stack:
    """Evidence of several recordings as one vector of whitened residuals."""

    def __init__(self, evidences: Sequence[Evidence], *, noise: float = 0.0, seed: int = 0) -> None:
        """Arrange the rows by recording, and within a recording by channel.

        Args:
            evidences: of the recordings.
            noise: factor of a noise of the sensors' level that is added.
            seed: of that noise.
        """
        self.evidences = tuple(evidences)
        records = [e.record for e in evidences]
        if noise:
            rng = np.random.default_rng(seed)
            levels = [{name: noise * level for name, level in deviations(record).items()} for record in records]
            records = [with_noise(record, own, rng) for record, own in zip(records, levels, strict=True)]
        self._comparisons = tuple(Comparison(record, e.setup) for record, e in zip(records, evidences, strict=True))
        self.channels: tuple[Channel, ...] = tuple(dict.fromkeys(c for e in evidences for c in e.channels))
        total = sum(len(e.record.time) * e.record.period for e in evidences)
        length = float(np.clip(total / FEWEST_CLUSTERS, SHORTEST_CLUSTER, LONGEST_CLUSTER))
        channel, cluster, before = list[NDArray[np.intp]](), list[NDArray[np.intp]](), 0
        for e in evidences:
            first = e.record.time[0]
            for c in e.channels:
                channel.append(np.full(len(e.times[c]), self.channels.index(c)))
                cluster.append(before + ((e.times[c] - first) / length).astype(np.intp))
            before = max([before, *(int(np.max(k)) + 1 for k in cluster)])
        self.channel = np.concatenate(channel) if channel else np.empty(0, dtype=np.intp)
        """Index in ``channels`` of each row's channel."""
        self.cluster = np.concatenate(cluster) if cluster else np.empty(0, dtype=np.intp)
        """Index of the stretch of each row."""

    def only(self, channels: Collection[Channel]) -> "Stack":
        """Return the stack of some channels."""
        parts = [replace(e, channels=tuple(c for c in e.channels if c in channels)) for e in self.evidences]
        return Stack([part for part in parts if part.channels])

    def residuals(self, rig: Rig, known: Sequence[Residuals] | None = None) -> tuple[Residuals, ...]:
        """Return the whitened residuals of a model in each recording, reusing equal ones of another model."""
        nothing = [Residuals({}, dict.fromkeys(e.channels)) for e in self.evidences]
        pairs = zip(self.evidences, self._comparisons, nothing if known is None else known, strict=True)
        return tuple(e.residuals(comparison, rig, before) for e, comparison, before in pairs)

    def slopes(self, rig: Rig, channels: Collection[Channel], parameters: int) -> Array:
        """Return the derivatives of the whitened residuals of some channels, shape (their rows, parameters).

        Args:
            rig: the model, of duals.
            channels: the channels.
            parameters: number of parameters on which the duals depend.
        """
        parts = [np.empty((0, parameters))]
        for e, comparison in zip(self.evidences, self._comparisons, strict=True):
            raw = comparison.residuals(rig, tuple(c for c in e.channels if c in channels))
            parts += whitened_slopes(e, raw, parameters).values()
        return np.concatenate(parts)

    def joined(self, residuals: Sequence[Residuals]) -> Array:
        """Return the concatenated residuals of all recordings, shape (rows,)."""
        parts = [r.joined(e.channels) for r, e in zip(residuals, self.evidences, strict=True)]
        return np.concatenate(parts) if parts else np.empty(0)

    def rows(self, channels: Collection[Channel]) -> NDArray[np.bool_]:
        """Return the mask of the rows of some channels."""
        numbers = [i for i, c in enumerate(self.channels) if c in channels]
        inside: NDArray[np.bool_] = np.isin(self.channel, numbers)
        return inside

    def scales(self, e: Array) -> Array:
        """Return the scale of each row's channel: the size of its residuals in units of noise, at least 1, shape (rows,).

        Args:
            e: whitened residuals, shape (rows,).
        """
        out = np.ones(len(e))
        for i in range(len(self.channels)):
            inside = self.channel == i
            if np.any(inside):
                out[inside] = max(1.0, GAUSS * float(np.median(np.abs(e[inside]))))
        return out


@dataclass(frozen=True)
class RigFit:
    """Coefficients fitted to recordings.

    Attributes:
        chosen: the coefficients.
        z: their coordinates, shape (p,).
        rig: the rig with them.
        rows: mask of the rows of the stack they were fitted to, shape (rows,).
        e: residuals of these rows in units of their channels' scales, shape (n,).
        scales: of these rows, shape (n,).
        loss: of ``e`` [nats].
        converged: whether the fit has converged.
        derivatives: computes ``jacobian``, which most fits from several starts do without.
    """

    chosen: tuple[Coefficient, ...]
    z: Array
    rig: Rig
    rows: NDArray[np.bool_]
    e: Array
    scales: Array
    loss: float
    converged: bool
    derivatives: Callable[[], Array]

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives of ``e`` by the coordinates, shape (n, p)."""
        return self.derivatives()

    @property
    def paths(self) -> tuple[str, ...]:
        """The coefficients' paths."""
        return tuple(c.path for c in self.chosen)

    @property
    def comparable(self) -> float:
        """The loss in units of the noise, for comparison of fits with different scales [nats]."""
        return float(np.sum(loss(self.e * self.scales)))


def fit(
    stack: Stack,
    rig: Rig,
    chosen: Sequence[Coefficient],
    channels: Collection[Channel],
    iterations: int = 20,
) -> RigFit:
    """Fit coefficients by damped Gauss-Newton steps of the Huber loss.

    If a stage is linear in its coefficients, the first step is their linear regression, however far the guess. The loss is
    scaled by each channel's scatter, so that large residuals of a poor guess count as squares, not as outliers.

    Args:
        stack: the recordings.
        rig: starting point of the fit.
        chosen: the coefficients to fit.
        channels: the channels to fit to.
        iterations: maximum number of steps; 0: only evaluate the start.
    """
    rows = stack.rows(channels)
    low, high = np.array([c.low for c in chosen]), np.array([c.high for c in chosen])
    guess = np.array([c.given for c in chosen])
    logarithm = np.array([c.scale == 0.0 for c in chosen], dtype=np.bool_)
    z = np.clip(np.array([c.coordinate(rig) for c in chosen]), low, high)

    def model(at: Array) -> Rig:
        return model_at(rig, chosen, at.tolist())

    def slopes(at: Array) -> Array:
        duals = [Dual(x, {i: 1.0}) for i, x in enumerate(at.tolist())]
        return stack.slopes(model_at(rig, chosen, duals), channels, len(chosen))

    residuals = stack.residuals(model(z))
    whole = stack.joined(residuals)
    scales = stack.scales(whole)[rows]
    converged = not chosen
    for iteration in range(iterations + 1):
        if converged or iteration == iterations:
            break
        e = whole[rows] / scales
        jacobian = slopes(z) / scales[:, np.newaxis]
        # The first guess counts as a measurement with a standard deviation of 1; it decides if the data do not.
        with_guess, directions = np.concatenate([e, z - guess]), np.vstack([jacobian, np.eye(len(chosen))])
        before = float(np.sum(loss(with_guess)))
        taken = None
        for damping in DAMPINGS:
            step = gauss_newton(directions, with_guess, damping, z, low, high)
            longest = float(np.max(np.abs(step[logarithm]), initial=0.0))
            step *= min(1.0, LONGEST_MOVE / longest) if longest > 0.0 else 1.0
            trial = np.clip(z + step, low, high)
            if before - linear_loss(with_guess, directions, trial - z) < CONVERGED + CONVERGED_FRACTION * before:
                break
            new = stack.residuals(model(trial), residuals)
            joined = stack.joined(new)
            after = float(np.sum(loss(joined[rows] / scales)) + np.sum(loss(trial - guess)))
            if after < before:
                taken = trial, new, joined, after
                break
        if taken is None:
            converged = True
            if iteration:
                break
            continue
        z, residuals, whole, after = taken
        now = stack.scales(whole)[rows]
        steady = bool(np.all(np.abs(now / scales - 1.0) < STEADY_SCALE))
        scales = now
        converged = steady and before - after < CONVERGED + CONVERGED_FRACTION * before
    e = whole[rows] / scales

    def derivatives() -> Array:
        return slopes(z) / scales[:, np.newaxis]

    return RigFit(tuple(chosen), z, model(z), rows, e, scales, float(np.sum(loss(e))), converged, derivatives)
