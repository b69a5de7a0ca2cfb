"""Judging a fitted hypothesis on data that it was not fitted to."""

from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Errors, Evidence, loss, noise_of, sections, weights
from ehls_ros.diagnosis.fit import Fit, Worker, products
from ehls_ros.diagnosis.hypotheses import Hypothesis, extended, parts
from ehls_ros.diagnosis.stages import Channel

PENALTY = 3.0
"""What every parameter of a cause costs [nats]."""

HUBER_SQUARE = 9.0
"""Square at which a whitened residual counts no further for the scatter."""


class Held(NamedTuple):
    """How a fit does on blocks that it was not fitted to.

    Attributes:
        gain: decrease of the loss against the model as it was given, by channel and block [nats], not yet scaled.
        errors: whitened residuals of the channels it changes, each block's with the parameters fitted to the others.
        inflation: by channel, how much more the remaining residuals scatter than noise would.
        covariance: of the parameters, shape (p, p).
        quieted: of the channels together, the loss that was taken off the gain because it comes of averaging noise [nats].
        disagreement: of each parameter, how much more its variance is by what the blocks say than by noise: at least 1.
    """

    gain: dict[Channel, Array]
    errors: Errors
    inflation: dict[Channel, float]
    covariance: Array
    quieted: float
    disagreement: Array


class Judged(NamedTuple):
    """A fitted hypothesis and how it does on held-out data."""

    fit: Fit
    held: Held

    @property
    def hypothesis(self) -> Hypothesis:
        """What was fitted."""
        return self.fit.hypothesis

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its causes."""
        return tuple(c.name for c in self.fit.hypothesis)

    def sigmas(self, index: int) -> float:
        """Return how many standard errors a cause's surest parameter is from its neutral value."""
        part = parts(self.hypothesis)[index]
        deviation = np.sqrt(np.maximum(np.diag(self.held.covariance)[part], 1e-300))
        return float(np.max(np.abs(self.fit.values[part] - self.hypothesis[index].neutral) / deviation))

    def score(self, inflation: dict[Channel, float]) -> float:
        """Return the held-out gain less the penalty for parameters [nats].

        Args:
            inflation: by which each channel's losses are divided, the same for all that are compared.
        """
        gain = sum(float(g.sum()) / inflation[c] for c, g in self.held.gain.items())
        return gain - PENALTY * len(self.fit.values)

    def excess(self, evidence: Evidence, channel: Channel) -> float:
        """Return the loss of a channel beyond what noise makes [nats]."""
        e = self.fit.errors.values[channel]
        return max(0.0, float(np.sum(loss(e)) - 1.5 * np.sum(loss(noise_of(evidence, channel)))))


def held_out(evidence: Evidence, fit: Fit, worker: Worker | None = None) -> Held:
    """Judge a fit on each block with the parameters fitted to the others.

    A block's influence on the parameters is taken off to first order, which needs no further evaluation. What a model
    gains by averaging the sensors' noise does not count.
    """
    e = fit.errors.together(fit.channels)
    block = np.concatenate([evidence.block[c] for c in fit.channels]) if fit.channels else np.empty(0, dtype=np.intp)
    p = len(fit.values)
    inflation = {c: inflation_of(fit.errors.values[c]) for c in fit.channels}
    w, normal = weights(e), np.zeros((p, p))
    # In units of what each parameter alone changes, so that newtons per metre and metres can be solved for together.
    scale = np.sqrt(np.maximum(np.sum(fit.jacobian**2, axis=0), 1e-300)) if p else np.ones(0)
    j = fit.jacobian / scale if p else fit.jacobian
    gradients, normals = np.zeros((evidence.blocks, p)), np.zeros((evidence.blocks, p, p))
    without = e.copy()
    for b in range(evidence.blocks):
        inside = block == b
        if not np.any(inside):
            continue
        jb, wb = j[inside], w[inside]
        normals[b], gradients[b] = products(jb, wb, e[inside])
    normal = normals.sum(axis=0)
    for b in range(evidence.blocks):
        inside = block == b
        if p and np.any(inside):
            shift = np.linalg.lstsq(normal - normals[b], gradients[b], rcond=1e-10)[0]
            without[inside] = e[inside] + j[inside] @ shift
    base = evidence.base.together(fit.channels)
    difference = loss(base) - loss(without)
    quieted = dict.fromkeys(fit.channels, 0.0)
    if worker is not None and fit.channels:
        model = extended(evidence.rig, fit.hypothesis, fit.values)
        quieted = evidence.quieted(worker.noisy, model, fit.errors, fit.channels)
    gain, errors = dict[Channel, Array](), dict(evidence.base.values)
    for c, section in sections(evidence.block, fit.channels).items():
        quieter = max(quieted[c], 0.0) / evidence.blocks
        per_block = np.bincount(evidence.block[c], weights=difference[section], minlength=evidence.blocks)
        gain[c] = np.asarray(per_block - quieter, dtype=np.float64)
        errors[c] = without[section]
    covariance, disagreement = _covariance(normal, gradients, fit, j, scale, inflation, evidence)
    saved = sum(max(value, 0.0) for value in quieted.values())
    return Held(gain, Errors(errors), inflation, covariance, saved, disagreement)


def inflation_of(e: Array) -> float:
    """Return by how much residuals scatter more than noise would: at least 1."""
    return max(1.0, float(np.mean(np.minimum(e * e, HUBER_SQUARE))))


def _covariance(
    normal: Array, gradients: Array, fit: Fit, j: Array, unit: Array, inflation: dict[Channel, float], evidence: Evidence
) -> tuple[Array, Array]:
    """Return the parameters' covariance, the larger of what noise and what the blocks' disagreement says; and the ratio."""
    if not fit.values.size:
        return np.empty((0, 0)), np.empty(0)
    inverse = np.linalg.pinv(normal)
    lengths = [len(evidence.block[c]) for c in fit.channels]
    scale = np.repeat([inflation[c] for c in fit.channels], lengths)
    w = weights(fit.errors.together(fit.channels))
    noise = inverse @ products(j, w * w * scale, scale)[0] @ inverse
    blocks = max(evidence.blocks - len(fit.values), 1)
    between = inverse @ (gradients.T @ gradients) @ inverse * evidence.blocks / blocks
    # Nothing is known of a parameter that the data do not tell; its errors are no numbers.
    with np.errstate(over="ignore", invalid="ignore"):
        larger = np.maximum(1.0, np.sqrt(np.maximum(np.diag(between), 0.0) / np.maximum(np.diag(noise), 1e-300)))
        return noise * np.outer(larger, larger) / np.outer(unit, unit), larger**2
