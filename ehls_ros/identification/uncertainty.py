"""Coefficients of a fit with their standard errors, and those that are not identifiable.

Standard errors follow from the fit's covariance and the derivatives of each coefficient by the fitted coordinates. A
coefficient whose standard error is a large fraction of its value is not reported as a number.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.estimate import Estimate
from ehls_ros.identification.covariance import PRIOR_STD
from ehls_ros.identification.joint import JointFit
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import declarations

MAX_STD = 0.25
"""Standard error, as a fraction of the value, above which a coefficient is not identifiable."""

MAX_CORRELATION = 0.999
"""Correlation above which two coefficients cannot be separated, unless one is well determined."""

SHARP = 0.02
"""Standard error, as a fraction of the value, below which a coefficient is well determined despite any correlation."""

STEP = 1e-6
"""Step of the numerical derivatives, relative, or absolute for coordinates below 1."""


class Estimates(NamedTuple):
    """All coefficients of the rig file with their standard errors.

    Attributes:
        rig: the rig with them.
        by_name: identified coefficients, by their names in the rig file, those of an element with its number.
        correlations: between them, shape (n, n).
        not_identifiable: names of the others.
        remarks: reasons why they are not identifiable.
    """

    rig: Rig
    by_name: Mapping[str, Estimate]
    correlations: Array
    not_identifiable: tuple[str, ...]
    remarks: tuple[str, ...]


class Propagated(NamedTuple):
    """Coefficients with the standard errors and correlations propagated from a covariance.

    Attributes:
        names: the coefficients.
        values: their values, shape (n,).
        std: their standard errors, shape (n,).
        correlations: between them, shape (n, n).
    """

    names: tuple[str, ...]
    values: Array
    std: Array
    correlations: Array

    @property
    def relative(self) -> Array:
        """Standard errors as fractions of the values, shape (n,)."""
        fraction: Array = self.std / np.maximum(np.abs(self.values), 1e-300)
        return fraction


def estimates(fit: JointFit, rig: Rig) -> Estimates:
    """Convert a fit into coefficients of the rig file.

    Args:
        fit: the joint fit.
        rig: the rig before it; its other coefficients are kept.

    Returns:
        The coefficients with their standard errors.
    """
    everything = np.concatenate([fit.z, fit.linear])
    values = coefficients(fit, everything, rig)
    changes = _derivatives(fit, everything, rig)
    free = np.array([name in fit.free for name in fit.coordinates.names] + [True] * len(fit.linear))
    moved = {name for name in values if np.any(changes[name][free])}
    # A coefficient that depends on nothing, such as the only element's weight, is known once the elements are.
    numbered = any(name in moved and name != _base(name, rig) for name in values)
    untouched = [
        name for name in values if name not in moved and (np.any(changes[name]) or (name != _base(name, rig) and not numbered))
    ]
    # A coordinate that was not searched for has its prior uncertainty.
    covariance = np.diag(np.where(free, 0.0, PRIOR_STD**2))
    covariance[np.ix_(free, free)] = fit.covariance
    found = propagated({name: values[name] for name in values if name in moved}, changes, covariance)
    vague, remarks = doubts(found)
    limited = np.array([name in fit.limited for name in fit.coordinates.names] + [False] * len(fit.linear))
    for name, value in zip(found.names, found.values, strict=True):
        if name not in vague and np.any(np.abs(changes[name][limited]) > MAX_STD * abs(value)):
            vague.add(name)
            remarks.append(f"{name} ended at a limit of its search.")
    fixed = []
    if "viscous_coefficient" in moved:
        fixed.append("viscous_damping")
        remarks.append(
            "viscous_damping and viscous_coefficient act alike; only their sum is identified, and viscous_damping is kept."
        )
    kept = [i for i, name in enumerate(found.names) if name not in vague]
    units = _units(rig)
    return Estimates(
        rig=_rig_with(rig, fit, values, untouched),
        by_name={
            found.names[i]: Estimate(float(found.values[i]), float(found.std[i]), units[_base(found.names[i], rig)])
            for i in kept
        },
        correlations=found.correlations[np.ix_(kept, kept)],
        not_identifiable=(*sorted(vague), *fixed, *dict.fromkeys(_base(name, rig) for name in untouched)),
        remarks=tuple(remarks),
    )


def propagated(values: Mapping[str, float], changes: Mapping[str, Array], covariance: Array) -> Propagated:
    """Propagate a covariance to standard errors and correlations of coefficients.

    Args:
        values: the coefficients by name.
        changes: derivatives of each by all coordinates and linear coefficients, shape (m,).
        covariance: of the coordinates and linear coefficients, shape (m, m).
    """
    names = tuple(values)
    derivative = np.array([changes[name] for name in names]).reshape(len(names), len(covariance))
    own = derivative @ covariance @ derivative.T
    std = np.sqrt(np.maximum(np.diag(own), 0.0))
    scale = np.where(std > 0.0, std, 1.0)
    return Propagated(names, np.array([values[name] for name in names]), std, own / scale[:, np.newaxis] / scale)


def doubts(found: Propagated) -> tuple[set[str], list[str]]:
    """Return the names of the coefficients that are not identifiable, or not separable, and a sentence for each reason."""
    relative = found.relative
    vague = {name for name, share in zip(found.names, relative, strict=True) if share > MAX_STD and name != "gravity"}
    remarks = [
        f"{name} has a standard error of {100 * share:.0f} %."
        for name, share in zip(found.names, relative, strict=True)
        if name in vague
    ]
    for i, first in enumerate(found.names):
        for j in range(i):
            correlation = found.correlations[i, j]
            both = {first, found.names[j]}
            if abs(correlation) > MAX_CORRELATION and min(relative[i], relative[j]) > SHARP and not both <= vague:
                vague |= both
                remarks.append(f"{found.names[j]} and {first} cannot be told apart (correlation {correlation:+.4f}).")
    return vague, remarks


def coefficients(fit: JointFit, everything: Array, rig: Rig) -> dict[str, float]:
    """Return the rig file's coefficients by name, those of an element with its number.

    Args:
        fit: for its coordinates and the names of its linear coefficients.
        everything: all coordinates followed by the linear coefficients.
        rig: for B0 and a mass that is not fitted.
    """
    size = len(fit.z)
    linear = dict(zip(fit.linear_names, everything[size:].tolist(), strict=True))
    out = flat(fit.coordinates.unpack(everything[:size]))
    if "viscous" in linear:
        out["viscous_coefficient"] = linear["viscous"] - rig.plant.viscous_damping
    if "spring" in linear:
        out["spring_stiffness"] = linear["spring"]
    if "mass" in linear:
        out["moving_mass"] = linear["mass"]
    if "constant" in linear:
        out["gravity"] = linear["constant"] / linear.get("mass", rig.plant.moving_mass)
    return out


def flat(friction: Any) -> dict[str, float]:
    """Return the coefficients of a friction model by name, those of a tuple with their number from 1."""
    out: dict[str, float] = {}
    for name, value in friction._asdict().items():
        if isinstance(value, tuple):
            out.update({f"{name}_{i}": float(item) for i, item in enumerate(value, start=1)})
        else:
            out[name] = float(value)
    return out


def _derivatives(fit: JointFit, everything: Array, rig: Rig) -> dict[str, Array]:
    """Return the derivatives of each coefficient by all coordinates and linear coefficients, by central differences."""
    columns = []
    for i in range(len(everything)):
        step = STEP * max(1.0, abs(everything[i]))
        ends = []
        for sign in (1.0, -1.0):
            moved = everything.copy()
            moved[i] += sign * step
            ends.append(coefficients(fit, moved, rig))
        columns.append({name: (ends[0][name] - ends[1][name]) / (2.0 * step) for name in ends[0]})
    return {name: np.array([column[name] for column in columns]) for name in columns[0]}


def _base(name: str, rig: Rig) -> str:
    """Return the name in the rig file of a coefficient that may carry the number of an element."""
    known: Sequence[str] = (*rig.friction._fields, *Plant._fields)
    return name if name in known else name.rpartition("_")[0]


def _rig_with(rig: Rig, fit: JointFit, values: Mapping[str, float], untouched: Sequence[str]) -> Rig:
    kept = {name: getattr(rig.friction, name) for name in dict.fromkeys(_base(name, rig) for name in untouched)}
    friction = fit.friction._replace(**kept)
    if "viscous" in fit.linear_names:
        friction = friction._replace(viscous_coefficient=max(0.0, values["viscous_coefficient"]))
    changed = {name: values[name] for name in ("spring_stiffness", "moving_mass") if name in values}
    if "gravity" in values and abs(values["gravity"]) < _GRAVITY_LIMIT:
        changed["gravity"] = values["gravity"]
    return rig._replace(plant=rig.plant._replace(**changed), friction=friction)


_GRAVITY_LIMIT = next(d.maximum for d in declarations(Plant) if d.name == "gravity") or 0.0


def _units(rig: Rig) -> dict[str, str]:
    """Return the units of all coefficients; those of a list are given in brackets at the end of its description."""
    out = {d.name: d.unit for d in declarations(Plant)}
    for declared in declarations(type(rig.friction)):
        bracketed = declared.description.rpartition("[")[2].rstrip("]") if declared.description.endswith("]") else "1"
        out[declared.name] = declared.unit or bracketed
    return out
