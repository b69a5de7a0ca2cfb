"""Correction of a fit for the noise of the signals in its derivatives.

Noise in a signal that multiplies a coefficient attenuates it: a mass on a noisy acceleration comes out too small, however long
the recording. To the recording, noise of the sensors' level is added and, in turn, subtracted. The mean of both changes of the
normal equations is of second order in the noise, as their bias by the noise that was recorded; it is subtracted from them
(corrected score: Nakamura, Biometrika 77, 1990; for a linear model the moment estimator of Fuller, Measurement Error Models,
1987, ch. 2).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.loss import weights
from ehls_ros.identification.rig_coefficients import model_at
from ehls_ros.identification.rig_fit import RigFit, Stack, fit

REALISATIONS = 3
"""Realisations of the added noise."""

STEPS = 3
"""Newton steps to the solution of the corrected equations."""

NEGLIGIBLE = 1e-3
"""Squared length of a step, in standard errors, at which the equations count as solved."""

LONGEST_STEP = 0.5
"""Largest change of a coordinate in one step."""

SHARES = (-1.0, 0.8)
"""Least and largest share of the information on any combination of coefficients that is attributed to noise."""

LEVEL_ERROR = 0.15
"""Relative error of the noise's power as estimated from the recording; it is uncertain by its colour."""


class Corrected(NamedTuple):
    """A fit corrected for noise.

    Attributes:
        fit: the fit at the corrected coordinates.
        spread: by path, standard error of the correction.
        gain: response of its coordinates to those of the uncorrected fit, shape (p, p).
    """

    fit: RigFit
    spread: dict[str, float]
    gain: Array


def corrected(stack: Stack, found: RigFit, noisy: Sequence[Stack]) -> Corrected:
    """Correct a converged fit for the noise in its derivatives.

    Args:
        stack: the recordings.
        found: the fit.
        noisy: the same recordings with added noise, from :func:`with_added_noise`.
    """
    if not found.chosen:
        return Corrected(found, {}, np.empty((0, 0)))
    chosen, channels = found.chosen, tuple(stack.channels[i] for i in np.unique(stack.channel[found.rows]))
    low, high, guess = (np.array([getattr(c, name) for c in chosen]) for name in ("low", "high", "given"))
    now = found
    pull, lost, information = _equations(now, noisy)
    for _ in range(STEPS):
        score = now.jacobian.T @ (weights(now.e) * now.e) - pull + now.z - guess
        step = np.clip(-np.linalg.solve(information - lost, score), -LONGEST_STEP, LONGEST_STEP)
        if float(step @ information @ step) < NEGLIGIBLE:
            break
        z = np.clip(now.z + step, low, high)
        now = fit(stack, model_at(now.rig, chosen, z.tolist()), chosen, channels, iterations=0)
        pull, lost, information = _equations(now, noisy)
    # An error of the noise's level changes the correction the more, the less information is left beside the noise.
    response = np.asarray(np.linalg.solve(information - lost, information), dtype=np.float64)
    uncertain = LEVEL_ERROR * np.abs(response @ (now.z - found.z))
    return Corrected(now, dict(zip(now.paths, uncertain.tolist(), strict=True)), response)


def gain(now: RigFit, noisy: Sequence[Stack], doubtful: int = 0) -> Array:
    """Return the response of corrected coordinates to those of an uncorrected fit, shape (p, p).

    Args:
        now: the fit.
        noisy: its recordings with added noise.
        doubtful: number of leading coefficients that were not fitted, and that are not corrected.
    """
    if not now.chosen:
        return np.empty((0, 0))
    _, lost, information = _equations(now, noisy)
    lost[:doubtful] = lost[:, :doubtful] = 0.0
    # What is left of a limited matrix may be beyond the limits again.
    lost = _limited(lost, information)
    return np.asarray(np.linalg.solve(information - lost, information), dtype=np.float64)


def rounding(stack: Stack, now: RigFit) -> dict[str, float]:
    """Return the standard errors of a fit's coordinates by the rounding of the motion in its local fit, by path.

    It is the same in all recordings, so that no scatter shows it: it is the change of the coordinates by a wider local fit.
    """
    if not now.chosen:
        return {}
    wider = Stack([replace(e, setup=e.setup.with_wider_fit()) for e in stack.evidences])
    weighted = now.jacobian * weights(now.e)[:, np.newaxis]
    change = wider.joined(wider.residuals(now.rig))[now.rows] / now.scales - now.e
    moved = np.linalg.solve(weighted.T @ now.jacobian + np.eye(len(now.chosen)), weighted.T @ change)
    return dict(zip(now.paths, np.abs(moved).tolist(), strict=True))


def with_added_noise(stack: Stack) -> tuple[Stack, ...]:
    """Return the recordings with realisations of a noise of the sensors' level added and subtracted."""
    return tuple(Stack(stack.evidences, noise=sign, seed=seed) for seed in range(REALISATIONS) for sign in (1.0, -1.0))


def _equations(now: RigFit, noisy: Sequence[Stack]) -> tuple[Array, Array, Array]:
    """Return the parts of score (p,) and information (p, p) that noise produces, and the information with that of the guess."""
    weight = weights(now.e)[:, np.newaxis]
    own = now.jacobian.T @ (weight * now.jacobian)
    pull, lost = -(now.jacobian.T @ (weight[:, 0] * now.e)), -own
    for stack in noisy:
        e, jacobian = _at(stack, now)
        pull += jacobian.T @ (weight[:, 0] * e) / len(noisy)
        lost += jacobian.T @ (weight * jacobian) / len(noisy)
    information = own + np.eye(len(now.chosen))
    return pull, _limited(lost, information), information


def _at(stack: Stack, now: RigFit) -> tuple[Array, Array]:
    """Return residuals and derivatives of a stack at the coordinates and in the scales of a fit."""
    at = fit(stack, now.rig, now.chosen, tuple(stack.channels[i] for i in np.unique(stack.channel[now.rows])), iterations=0)
    rescaled = at.scales / now.scales
    return at.e * rescaled, at.jacobian * rescaled[:, np.newaxis]


def _limited(lost: Array, information: Array) -> Array:
    """Return the information of noise, with its share in every combination of coefficients within :data:`SHARES`."""
    root = np.linalg.cholesky(information)
    inverse = np.linalg.inv(root)
    shares, vectors = np.linalg.eigh(inverse @ lost @ inverse.T)
    turned = root @ vectors
    return np.asarray((turned * np.clip(shares, *SHARES)) @ turned.T, dtype=np.float64)
