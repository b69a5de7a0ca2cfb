"""Identifiability of a rig's coefficients: which the recordings determine, and which only in combination."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.loss import weights
from ehls_ros.estimate import Estimate
from ehls_ros.identification.covariance import clustered_covariance
from ehls_ros.identification.rig_coefficients import slopes_at, values_at
from ehls_ros.identification.rig_fit import RigFit, Stack

MAX_STD = 0.25
"""Standard error of a coordinate above which its coefficient is not identified: a quarter of the value or of its scale."""

MIN_SHARE = 0.3
"""Share of the largest entry of a singular vector above which another coefficient belongs to the combination."""

OVERLAP = 2.0
"""Number of neighbouring windows that contain the same sample."""


ACCURACY: Mapping[str, float] = {
    "plant.discharge_coefficient": 1e-7,
    "plant.leakage_coefficient": 1e-5,
    "plant.bulk_modulus": 1e-5,
    "friction.coulomb_force": 2e-5,
    "friction.viscous_coefficient": 2e-5,
    "friction.element_stiffness": 1e-4,
    "friction.static_force": 7e-3,
    "friction.stribeck_velocity": 3e-2,
    "friction.stribeck_exponent": 1.2e-2,
    "friction.attraction_rate": 4e-3,
}
"""Error of coefficients due to the stages' approximation between samples, as a fraction of the value.

Rms error of a fit to 8 recordings of the truth generator without any noise, 25 s at 1 kHz, rounded up
(`python -m benchmarks.rig_identification --cases 8 --duration 25 --noise 0`); it grows with the square of the sampling period.
"""

ACCURATE_PERIOD = 1e-3
"""Sampling period of the recordings behind :data:`ACCURACY` [s]."""

FORM_WINDOWS = 40.0
"""Number of windows over which an error of the model's form averages out, however long the recording.

It depends on the operating point, to which the rig returns, so that the jackknife over stretches sees too little of it. Origin:
with 100, the errors of mass and Coulomb friction of eight rigs of benchmarks.strangers, seed 378101, whose friction is of
another law, were 1.6 times their standard errors (rms).
"""

FORM_WINDOWS_OF_ABSENT = 100.0
"""The same where the errors decide whether an effect is absent: one that is there costs more if it is left out than one that is
not there if it is kept.

Origin: with 40, null and constant load of the fatigue rig of examples/faster, 3.4 and 3.0 standard errors from none, are left
out, and the force is predicted with an error of 13.7 instead of 7.0 %.
"""

NO_FORM = 1.2
"""Power of a channel's residuals, in units of its noise floor, up to which they count as noise: the floor is an estimate."""

AT_LIMIT = 1e-9
"""Distance from a limit of the search within which a coordinate counts as at the limit."""


class Unidentifiable(NamedTuple):
    """A coefficient that the data do not identify.

    Attributes:
        path: the coefficient.
        reason: reason in words.
        excited: whether any residual depends on it.
    """

    path: str
    reason: str
    excited: bool = True


def covariance(stack: Stack, fit: RigFit, doubtful: int = 0, form_windows: float = math.inf) -> Array:
    """Return the jackknife covariance of a fit's coordinates over stretches of the recordings, shape (p, p).

    Args:
        stack: the recordings.
        fit: the fit.
        doubtful: number of leading coefficients that were not fitted and are as uncertain as a guess.
        form_windows: number of windows over which an error of the model's form averages out.
    """
    if not fit.chosen:
        return np.empty((0, 0))
    root, clusters = np.sqrt(weights(fit.e)), stack.cluster[fit.rows].astype(np.float64)
    e = fit.e * root * _form(stack, fit, form_windows)
    return clustered_covariance(fit.jacobian * root[:, np.newaxis], e, clusters, doubtful)


def _form(stack: Stack, fit: RigFit, form_windows: float) -> Array:
    """Return the factor on each residual by which an error of the form counts more than one that averages out, shape (n,)."""
    power = fit.scales**2
    share = np.maximum(0.0, power - NO_FORM) / power
    channel = stack.channel[fit.rows]
    windows = np.bincount(channel, minlength=len(stack.channels))[channel]
    return np.sqrt(1.0 + share * windows / (OVERLAP * form_windows))


def unidentifiable(stack: Stack, fit: RigFit, rank: Mapping[str, int]) -> tuple[Unidentifiable, ...]:
    """Find the coefficients that have to be kept at their given values so that the others are identifiable.

    The weakest combination of coefficients is the singular vector of the least singular value. While it is too weak for one
    of them, one of its members is kept.

    Args:
        stack: the recordings.
        fit: all coefficients fitted.
        rank: by path; of the members of a combination, the one with the highest rank is kept.

    Returns:
        The coefficients to keep, with the reasons.
    """
    out = list[Unidentifiable]()
    left = list(range(len(fit.chosen)))
    jacobian = fit.jacobian * np.sqrt(weights(fit.e))[:, np.newaxis] / np.sqrt(OVERLAP)
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    for i in list(left):
        if size[i] * MAX_STD < 1.0:
            left.remove(i)
            nothing = "no residual depends on it" if size[i] == 0.0 else "the data hardly depend on it"
            out.append(Unidentifiable(fit.paths[i], f"not excited: {nothing}", excited=False))
        elif fit.chosen[i].scale == 0.0 and _at_limit(fit, i):
            left.remove(i)
            out.append(Unidentifiable(fit.paths[i], "it ended at a limit of its search"))
    while left:
        part = jacobian[:, left]
        _, values, vectors = np.linalg.svd(part, full_matrices=False)
        errors = (vectors / np.maximum(values, 1e-300)[:, np.newaxis]) ** 2
        spread = np.maximum(np.sum(errors, axis=0), np.diag(covariance(stack, _only(fit, left))))
        worst = int(np.argmax(spread))
        if spread[worst] <= MAX_STD**2:
            break
        weakest = int(np.argmax(errors[:, worst]))
        entries = np.abs(vectors[weakest])
        partners = [i for i in range(len(left)) if entries[i] >= MIN_SHARE * np.max(entries)]
        if worst not in partners:
            partners.append(worst)
        dropped = max(partners, key=lambda i: (rank.get(fit.paths[left[i]], 0), spread[i]))
        others = [fit.paths[left[i]] for i in partners if i != dropped]
        share = 100.0 * float(np.sqrt(spread[dropped]))
        reason = f"only its combination with {_listed(others)} is known" if others else f"its standard error is {share:.0f} %"
        out.append(Unidentifiable(fit.paths[left[dropped]], reason))
        del left[dropped]
    return tuple(out)


def _at_limit(fit: RigFit, index: int) -> bool:
    """Return whether a coordinate is at a limit.

    Static friction equal to Coulomb friction counts: the shape of the Stribeck curve then has no effect on the interval.
    """
    c, z = fit.chosen[index], float(fit.z[index])
    return z >= c.high - AT_LIMIT or z <= c.low + AT_LIMIT


def _only(fit: RigFit, columns: Sequence[int]) -> RigFit:
    return replace(
        fit,
        chosen=tuple(fit.chosen[i] for i in columns),
        z=fit.z[list(columns)],
        derivatives=lambda: fit.jacobian[:, list(columns)],
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


class Estimated(NamedTuple):
    """Fitted coefficients with their errors.

    Attributes:
        by_path: the coefficients.
        covariance: of their values, shape (p, p).
        vague: coefficients whose standard error is large.
    """

    by_path: Mapping[str, Estimate]
    covariance: Array
    vague: tuple[str, ...]


def estimated(
    stack: Stack,
    fit: RigFit,
    doubtful: int = 0,
    spread: Mapping[str, float] | None = None,
    gain: Array | None = None,
    *,
    form_windows: float = math.inf,
) -> Estimated:
    """Return the values of a fit's coefficients with their standard errors.

    Args:
        stack: the recordings.
        fit: the fit.
        doubtful: number of leading coefficients that were not fitted; their uncertainty propagates to the others.
        spread: by path, further standard errors of coordinates.
        gain: response of the coordinates to those of least squares, shape (p, p); by default they are those.
        form_windows: number of windows over which an error of the model's form averages out.
    """
    values, slopes = values_at(fit.rig, fit.chosen, fit.z.tolist()), slopes_at(fit.rig, fit.chosen, fit.z)
    slower = max([1.0, *((e.record.period / ACCURATE_PERIOD) ** 2 for e in stack.evidences)])
    wrong = np.array([slower * ACCURACY.get(c.path, 0.0) * values[c.path] for c in fit.chosen])
    further = np.array([(spread or {}).get(path, 0.0) for path in fit.paths])
    least_squares = covariance(stack, fit, doubtful, form_windows)
    coordinates = least_squares if gain is None else gain @ least_squares @ gain.T
    own: Array = slopes @ (coordinates + np.diag(further**2)) @ slopes.T + np.diag(wrong**2)
    std = np.sqrt(np.maximum(np.diag(own), 0.0))
    scales = [c.scale or abs(values[c.path]) for c in fit.chosen]
    by_path = {c.path: Estimate(values[c.path], float(s), c.unit) for c, s in zip(fit.chosen, std, strict=True)}
    vague = tuple(c.path for c, s, scale in zip(fit.chosen, std, scales, strict=True) if s > MAX_STD * scale)
    return Estimated(by_path, own, vague)
