"""Correction of fitted parameters for the noise of the signals in their derivatives.

Noise in a signal that multiplies a parameter attenuates it: a mass on a noisy acceleration comes out too small, however long
the recording. To the recording, noise of the sensors' level is added and, in turn, subtracted. The mean of both changes of the
normal equations is of second order in the noise, as their bias by the noise that was recorded; it is subtracted from them
(corrected score: Nakamura, Biometrika 77, 1990; for a linear model the moment estimator of Fuller, Measurement Error Models,
1987, ch. 2).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Evidence, sections
from ehls_ros.diagnosis.fit import Fit, Worker
from ehls_ros.diagnosis.hypotheses import bounds
from ehls_ros.diagnosis.loss import weights
from ehls_ros.diagnosis.noise import deviations, with_noise
from ehls_ros.diagnosis.stages import Channel

ADDED_REALISATIONS = 3
"""Realisations of the added noise."""

SHARES = (-1.0, 0.8)
"""Least and largest share of the information on any combination of parameters that is attributed to noise."""

LEVEL_ERROR = 0.15
"""Relative error of the noise's power as estimated from the recording; it is uncertain by its colour."""

SURE = 4.3
"""Standard errors of its realisations' mean that a correction must exceed: of three, chance passes them once in 20."""

SINGULAR = 1e12
"""Condition of the information from which on its combinations of parameters are rounding."""


class NoisePart(NamedTuple):
    """Parts of the normal equations that noise produces.

    Attributes:
        pulls: of their score, by pair of realisations, shape (pairs, p).
        lost: of their information, shape (p, p); shares beyond :data:`SHARES` are reduced to these in both.
    """

    pulls: Array
    lost: Array


def information_of(e: Array, jacobian: Array) -> Array:
    """Return the information on the parameters, shape (p, p), of residuals (n,) with derivatives (n, p)."""
    return np.asarray(jacobian.T @ (weights(e)[:, np.newaxis] * jacobian), dtype=np.float64)


def noise_part(e: Array, jacobian: Array, noisy: Iterable[tuple[Array, Array]], own: Array, prior: Array) -> NoisePart:
    """Return the parts of the normal equations that noise produces.

    Args:
        e: residuals of a fit, shape (n,).
        jacobian: their derivatives, shape (n, p).
        noisy: the same with a realisation of the noise added, and with it subtracted, in turn.
        own: their information on the parameters, shape (p, p).
        prior: information of other sources, shape (p, p).
    """
    weight = weights(e)
    score = jacobian.T @ (weight * e)
    scores, informations = list[Array](), list[Array]()
    for more, slopes in noisy:
        scores.append(slopes.T @ (weight * more) - score)
        informations.append(slopes.T @ (weight[:, np.newaxis] * slopes) - own)
    pulls = np.mean(np.reshape(scores, (-1, 2, len(own))), axis=1)
    basis, shares = _shares(np.mean(informations, axis=0), own + prior)
    within = np.clip(shares, *SHARES)
    # Of a derivative that diverges with the noise, the pull is no more to be believed than the information.
    believed = np.divide(within, shares, out=np.ones_like(shares), where=shares != 0.0)
    return NoisePart(np.linalg.solve(basis, pulls.T).T * believed @ basis.T, (basis * within) @ basis.T)


def limited(lost: Array, information: Array) -> Array:
    """Return the information of noise, with its share in every combination of parameters within :data:`SHARES`."""
    basis, shares = _shares(lost, information)
    return np.asarray((basis * np.clip(shares, *SHARES)) @ basis.T, dtype=np.float64)


def _shares(lost: Array, information: Array) -> tuple[Array, Array]:
    """Return the combinations of parameters in which noise's information is independent, and its shares of all of it.

    Returns:
        Basis B with information = B Bᵀ and lost = B diag(shares) Bᵀ, shape (p, p), and the shares, shape (p,).
    """
    root = np.linalg.cholesky(information)
    inverse = np.linalg.inv(root)
    shares, vectors = np.linalg.eigh(inverse @ lost @ inverse.T)
    return root @ vectors, shares


class Corrected(NamedTuple):
    """Parameters of a fit corrected for noise.

    Attributes:
        values: the parameters, shape (p,).
        covariance: of these, shape (p, p).
    """

    values: Array
    covariance: Array


def corrected(evidence: Evidence, fit: Fit, covariance: Array) -> Corrected:
    """Correct the parameters of a fit for the noise in its derivatives.

    Parameters stay if derivatives are expensive, and each whose correction is no larger than chance.

    Args:
        evidence: the recording compared with the given model.
        fit: the fit.
        covariance: of its parameters, shape (p, p).
    """
    unchanged = Corrected(fit.values, covariance)
    unit = np.sqrt(np.sum(fit.jacobian**2, axis=0))
    if fit.costly or not fit.values.size or not np.all(unit > 0.0):
        return unchanged
    e, jacobian = fit.residuals.joined(fit.channels), fit.jacobian / unit
    information = information_of(e, jacobian)
    if not np.linalg.cond(information) < SINGULAR:
        return unchanged
    noisy = [(more, slopes / unit) for more, slopes in _noisy(evidence, fit)]
    pulls, lost = noise_part(e, jacobian, noisy, information, np.zeros_like(information))
    steps = np.linalg.solve(information - lost, pulls.T).T
    step, chance = np.mean(steps, axis=0), np.std(steps, axis=0, ddof=1) / np.sqrt(len(steps))
    step = np.where(np.abs(step) > SURE * chance, step, 0.0)
    response = np.linalg.solve(information - lost, information)
    lower, upper = bounds(fit.hypothesis)
    values = np.clip(fit.values + step / unit, lower, upper)
    uncertain = np.where(step != 0.0, np.hypot(LEVEL_ERROR * step, chance), 0.0) / unit
    response = response * unit / unit[:, np.newaxis]
    return Corrected(values, response @ covariance @ response.T + np.diag(uncertain**2))


def _noisy(evidence: Evidence, fit: Fit) -> Iterator[tuple[Array, Array]]:
    """Yield residuals and derivatives of a fit with noise of the sensors' level added and, in turn, subtracted."""
    levels = deviations(evidence.record)
    for seed in range(ADDED_REALISATIONS):
        for sign in (1.0, -1.0):
            signed = {name: sign * level for name, level in levels.items()}
            record = with_noise(evidence.record, signed, np.random.default_rng(seed))
            there = Worker(replace(evidence, record=record)).linearise(fit.hypothesis, fit.values, fit.steps)
            yield there.residuals.joined(fit.channels), _in(evidence, there, fit.channels)


def _in(evidence: Evidence, fit: Fit, channels: Sequence[Channel]) -> Array:
    """Return the derivatives of a fit in some channels, shape (n, p)."""
    rows = sections(evidence.block, fit.channels)
    none = {c: np.zeros((len(evidence.block[c]), len(fit.values))) for c in channels}
    return np.concatenate([fit.jacobian[rows[c]] if c in rows else none[c] for c in channels])
