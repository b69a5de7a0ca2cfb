"""Cross-validation of fitted hypotheses on held-out blocks, and their relative probabilities."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, Residuals, sections
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.hypotheses import Hypothesis, bounds, extended, parts
from ehls_ros.diagnosis.loss import inflation, loss, products, weights
from ehls_ros.diagnosis.stages import Channel

HELD_OUT_CUTOFF = 1e-10
"""Relative singular value below which a direction is left out of the step to the held-out fit."""

RESAMPLED = 1000
"""Bootstrap samples of the blocks for probabilities and intervals."""


class HeldOut(NamedTuple):
    """Performance of a fit on held-out blocks.

    Attributes:
        gain: decrease of the loss against the given model, by channel and block, shape (blocks,) [nats]; not yet divided by
            the channel's inflation.
        residuals: whitened; in the channels it changes, those of each block come from the fit to the other blocks.
        covariance: of the parameters, shape (p, p).
        averaged: gain from averaging noise, over all channels [nats]; already subtracted from the gain.
    """

    gain: Mapping[Channel, Array]
    residuals: Residuals
    covariance: Array
    averaged: float


class Assessment(NamedTuple):
    """A fitted hypothesis and its performance on held-out data.

    Attributes:
        fit: the fit.
        held_out: its performance.
        corrected: its parameters corrected for noise (:mod:`ehls_ros.diagnosis.attenuation`), shape (p,); None if they are not.
    """

    fit: Fit
    held_out: HeldOut
    corrected: Array | None = None

    @property
    def values(self) -> Array:
        """The parameters' estimates, shape (p,)."""
        return self.fit.values if self.corrected is None else self.corrected

    @property
    def hypothesis(self) -> Hypothesis:
        """The fitted hypothesis."""
        return self.fit.hypothesis

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its causes."""
        return tuple(c.name for c in self.fit.hypothesis)

    def sigmas(self, index: int) -> float:
        """Return the distance of a cause from its neutral values, in standard errors of their best-determined combination.

        Two gains of a valve may be vague while their difference is not. A mass that yields is at most as certain as
        the best-determined size of its yielding.
        """
        part = parts(self.hypothesis)[index]
        away, covariance = self.values[part] - self.hypothesis[index].neutral, self.held_out.covariance[part, part]
        # A parameter without effect has no variance, or a negative one by rounding.
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        known = (deviation > 0.0) & np.isfinite(deviation)
        if not np.any(known):
            return 0.0
        away = away[known] / deviation[known]
        correlation = covariance[np.ix_(known, known)] / np.outer(deviation[known], deviation[known])
        distance = math.sqrt(max(float(away @ np.linalg.pinv(correlation, hermitian=True) @ away), 0.0))
        yields = [abs(self.values[part][i]) / deviation[i] for i in self.hypothesis[index].yielding if known[i]]
        return min(distance, max(yields, default=math.inf))

    def per_block(self, inflation: Mapping[Channel, float]) -> Array:
        """Return the held-out gain of each block, shape (blocks,) [nats]; a zero of shape (1,) if nothing is changed.

        Args:
            inflation: divisor of each channel's losses, the same for all compared hypotheses.
        """
        return sum((gain / inflation[c] for c, gain in self.held_out.gain.items()), np.zeros(1))

    def score(self, inflation: Mapping[Channel, float]) -> float:
        """Return the held-out gain less the penalty for parameters [nats].

        Args:
            inflation: divisor of each channel's losses, the same for all compared hypotheses.
        """
        return sum(self.gains(inflation).values()) - rules.PENALTY * len(self.fit.values)

    def gains(self, inflation: Mapping[Channel, float]) -> dict[Channel, float]:
        """Return the held-out gain in each channel that is changed [nats].

        Args:
            inflation: divisor of each channel's losses.
        """
        return {c: float(gain.sum()) / inflation[c] for c, gain in self.held_out.gain.items()}

    def excess(self, evidence: Evidence, channel: Channel) -> float:
        """Return the excess of a channel's loss over that of noise [nats]."""
        e = self.fit.residuals.values[channel]
        return max(0.0, float(np.sum(loss(e)) - rules.LITTLE * np.sum(loss(evidence.noise[channel]))))


def assess(evidence: Evidence, fit: Fit, worker: Worker | None = None) -> Assessment:
    """Assess a fit on each block with the parameters fitted to the others.

    Args:
        evidence: the recording compared with the given model.
        fit: the fitted hypothesis.
        worker: evaluates the gain from averaging noise, which is subtracted; if None, nothing is subtracted.
    """
    channels = fit.channels
    e = fit.residuals.joined(channels)
    block = np.concatenate([evidence.block[c] for c in channels]) if channels else np.empty(0, dtype=np.intp)
    variances = [inflation(fit.residuals.values[c]) * evidence.correlation.get(c, 1.0) for c in channels]
    scatter = np.repeat(variances, [len(evidence.block[c]) for c in channels])
    room = tuple(limit - fit.values for limit in bounds(fit.hypothesis))
    without, covariance = leave_out(fit.jacobian, e, block, evidence.blocks, scatter, room)
    averaged: Mapping[Channel, float] = dict.fromkeys(channels, 0.0)
    if worker is not None and channels:
        model = extended(evidence.rig, fit.hypothesis, fit.values)
        averaged = evidence.averaged_noise(worker.noisy, model, fit.residuals, channels)
    difference = loss(evidence.base.joined(channels)) - loss(without)
    gain, residuals = dict[Channel, Array](), dict(evidence.base.values)
    for c, rows in sections(evidence.block, channels).items():
        quieter = max(averaged[c], 0.0) / evidence.blocks
        per_block = np.bincount(evidence.block[c], weights=difference[rows], minlength=evidence.blocks)
        gain[c] = np.asarray(per_block - quieter, dtype=np.float64)
        residuals[c] = without[rows]
    saved = sum(max(value, 0.0) for value in averaged.values())
    return Assessment(fit, HeldOut(gain, Residuals(residuals), covariance, saved))


def leave_out(
    jacobian: Array,
    e: Array,
    block: NDArray[np.intp],
    blocks: int,
    scatter: Array,
    room: tuple[Array, ...] = (np.array(-np.inf), np.array(np.inf)),
) -> tuple[Array, Array]:
    """Return each block's residuals with the parameters fitted to the other blocks, and the parameters' covariance.

    The influence of a block is removed to first order, without a further run of the model. The covariance is the larger of
    those implied by noise and by the disagreement between the blocks.

    Args:
        jacobian: derivatives of the whitened residuals at the optimum, shape (n, p).
        e: the residuals, shape (n,).
        block: block of each residual, shape (n,).
        blocks: number of blocks.
        scatter: variance of each residual in units of the noise's, shape (n,).
        room: distances of the parameters from their lower and from their upper bounds, shape (p,); one at a bound stays there.

    Returns:
        Residuals, shape (n,), and covariance, shape (p, p).
    """
    p = jacobian.shape[1]
    w = weights(e)
    # Parameters are scaled by their effect on the residuals, so that newtons per metre and metres can be solved together.
    unit = np.sqrt(np.maximum(np.sum(jacobian**2, axis=0), 1e-300)) if p else np.ones(0)
    j = jacobian / unit if p else jacobian
    gradients, normals = np.zeros((blocks, p)), np.zeros((blocks, p, p))
    members = [block == b for b in range(blocks)]
    for b, inside in enumerate(members):
        if np.any(inside):
            normals[b], gradients[b] = products(j[inside], w[inside], e[inside])
    normal = normals.sum(axis=0)
    without = e.copy()
    lower, upper = (np.broadcast_to(distance, p) * unit for distance in room)
    free = np.flatnonzero((lower < 0.0) & (upper > 0.0))
    for b, inside in enumerate(members):
        if free.size and np.any(inside):
            left = (normal - normals[b])[np.ix_(free, free)]
            shift = np.linalg.lstsq(left, gradients[b][free], rcond=HELD_OUT_CUTOFF)[0]
            # A direction that only this block determines leads to the bounds, far beyond which nothing is linear.
            reached = np.clip(shift, lower[free], upper[free])
            part = np.min(np.divide(reached, shift, out=np.ones_like(shift), where=shift != 0.0))
            without[inside] = e[inside] + j[np.ix_(inside, free)] @ (part * shift)
    if not p:
        return without, np.empty((0, 0))
    inverse = np.linalg.pinv(normal)
    noise = inverse @ products(j, w * w * scatter, scatter)[0] @ inverse
    between = inverse @ (gradients.T @ gradients) @ inverse * blocks / max(blocks - p, 1)
    # The errors of a parameter that the data do not determine may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        larger = np.maximum(1.0, np.sqrt(np.maximum(np.diag(between), 0.0) / np.maximum(np.diag(noise), 1e-300)))
        return without, noise * np.outer(larger, larger) / np.outer(unit, unit)


def probabilities(gains: Sequence[Array], parameters: Sequence[int], seed: int) -> Array:
    """Return the probability of each of several hypotheses, given their gains on the held-out blocks.

    Stacking by a Bayesian bootstrap of the blocks (Yao, Vehtari, Simpson, Gelman 2018): the mean over resamplings of its share
    of the likelihood.

    Args:
        gains: of each hypothesis, shape (blocks,) [nats]; empty for a hypothesis that changes nothing.
        parameters: number of free parameters of each.
        seed: of the resampling.

    Returns:
        The probabilities, shape (hypotheses,).
    """
    rng = np.random.default_rng(seed)
    blocks = max((len(g) for g in gains), default=1)
    table = np.array([np.resize(g, blocks) if len(g) else np.zeros(blocks) for g in gains])
    penalty = rules.PENALTY * np.array(parameters)
    weights = rng.dirichlet(np.ones(blocks), RESAMPLED) * blocks
    scores = weights @ table.T - penalty
    scores -= scores.max(axis=1, keepdims=True)
    likelihood = np.exp(scores)
    mean: Array = np.mean(likelihood / likelihood.sum(axis=1, keepdims=True), axis=0)
    return mean
