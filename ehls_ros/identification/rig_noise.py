"""Correction of a fitted rig for the noise of the signals (:mod:`ehls_ros.diagnosis.attenuation`)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.attenuation import ADDED_REALISATIONS, LEVEL_ERROR, information_of, limited, noise_part
from ehls_ros.diagnosis.loss import weights
from ehls_ros.identification.rig_coefficients import model_at
from ehls_ros.identification.rig_fit import RigFit, Stack, fit

STEPS = 3
"""Newton steps to the solution of the corrected equations."""

NEGLIGIBLE = 1e-3
"""Squared length of a step, in standard errors, at which the equations count as solved."""

LONGEST_STEP = 0.5
"""Largest change of a coordinate in one step."""


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
    lost = limited(lost, information)
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
    return tuple(Stack(stack.evidences, noise=sign, seed=seed) for seed in range(ADDED_REALISATIONS) for sign in (1.0, -1.0))


def _equations(now: RigFit, noisy: Sequence[Stack]) -> tuple[Array, Array, Array]:
    """Return the parts of score (p,) and information (p, p) that noise produces, and the information with that of the guess."""
    own, prior = information_of(now.e, now.jacobian), np.eye(len(now.chosen))
    part = noise_part(now.e, now.jacobian, (_at(stack, now) for stack in noisy), own, prior)
    return np.mean(part.pulls, axis=0), part.lost, own + prior


def _at(stack: Stack, now: RigFit) -> tuple[Array, Array]:
    """Return residuals and derivatives of a stack at the coordinates and in the scales of a fit."""
    at = fit(stack, now.rig, now.chosen, tuple(stack.channels[i] for i in np.unique(stack.channel[now.rows])), iterations=0)
    rescaled = at.scales / now.scales
    return at.e * rescaled, at.jacobian * rescaled[:, np.newaxis]
