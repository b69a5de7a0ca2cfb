"""What a fit says of each coefficient, how surely, and what it cannot say.

Standard errors come from the fit's covariance, by the derivative of each coefficient with respect to what was
searched for. A coefficient whose standard error is a large part of itself is not given as a number.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.estimate import Estimate
from ehls_ros.identification.joint import JointFit
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import declarations

VAGUE = 0.25
"""Standard error, as a part of the value, from which a coefficient counts as not identifiable."""

TANGLED = 0.999
"""Correlation from which two coefficients cannot be told apart, if neither is sharp."""

SHARP = 0.02
"""Standard error, as a part of the value, below which a coefficient is known whatever it is correlated with."""

STEP = 1e-6


class Estimates(NamedTuple):
    """All coefficients.

    Attributes:
        rig: the rig with them.
        by_name: those the data say something of.
        correlations: between them.
        not_identifiable: names of the others.
        remarks: why.
    """

    rig: Rig
    by_name: Mapping[str, Estimate]
    correlations: Array
    not_identifiable: tuple[str, ...]
    remarks: tuple[str, ...]


def estimates(fit: JointFit, rig: Rig) -> Estimates:
    """Turn a fit into coefficients of the rig file.

    Args:
        fit: the joint fit.
        rig: the rig before it, whose B0, mass and gravity are kept or moved.

    Returns:
        The coefficients with their standard errors.
    """
    free = [fit.layout.names.index(name) for name in fit.free]
    searched = np.concatenate([fit.z[free], fit.linear])

    def of(vector: Array) -> dict[str, float]:
        z = fit.z.copy()
        z[free] = vector[: len(free)]
        return _coefficients(fit.layout.unpack(z), dict(zip(fit.linear_names, vector[len(free) :], strict=True)), rig)

    values = of(searched)
    names = [name for name in values if _depends(name, fit)]
    derivative = np.empty((len(names), len(searched)))
    for i in range(len(searched)):
        step = STEP * max(1.0, abs(searched[i]))
        moved = searched.copy()
        moved[i] += step
        changed = of(moved)
        derivative[:, i] = [(changed[name] - values[name]) / step for name in names]
    covariance = derivative @ fit.covariance @ derivative.T
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    correlations = covariance / np.where(std > 0.0, std, 1.0)[:, np.newaxis] / np.where(std > 0.0, std, 1.0)
    relative = std / np.maximum(np.abs([values[name] for name in names]), 1e-300)

    vague = {name for name, part in zip(names, relative, strict=True) if part > VAGUE and name != "gravity"}
    remarks = [f"{name} has a standard error of {100 * relative[names.index(name)]:.0f} %." for name in names if name in vague]
    for i, first in enumerate(names):
        for j in range(i):
            if abs(correlations[i, j]) > TANGLED and min(relative[i], relative[j]) > SHARP:
                vague |= {first, names[j]}
                remarks.append(f"{names[j]} and {first} cannot be told apart (correlation {correlations[i, j]:+.4f}).")
    if "viscous_coefficient" in names:
        remarks.append(
            "viscous_damping and viscous_coefficient act alike; only their sum is identified, and viscous_damping is kept."
        )
    kept = [i for i, name in enumerate(names) if name not in vague]
    units = _units()
    fixed = ("viscous_damping",) if "viscous_coefficient" in names else ()
    return Estimates(
        rig=_rig_with(rig, fit, values),
        by_name={names[i]: Estimate(values[names[i]], float(std[i]), units[names[i].rstrip("_0123456789")]) for i in kept},
        correlations=correlations[np.ix_(kept, kept)],
        not_identifiable=(*sorted(vague), *fixed, *_untouched(fit)),
        remarks=tuple(remarks),
    )


def _coefficients(friction: Friction, linear: Mapping[str, float], rig: Rig) -> dict[str, float]:
    """Return the rig file's coefficients by name; those of the elements with their number."""
    out = {
        "coulomb_force": friction.coulomb_force,
        "static_force": friction.static_force,
        "stribeck_velocity": friction.stribeck_velocity,
        "stribeck_exponent": friction.stribeck_exponent,
        "viscous_coefficient": linear["viscous"] - rig.plant.viscous_damping,
        "attraction_rate": friction.attraction_rate,
    }
    for i, (stiffness, weight) in enumerate(zip(friction.element_stiffness, friction.element_weight, strict=True), start=1):
        out[f"element_stiffness_{i}"] = stiffness
        out[f"element_weight_{i}"] = weight
    mass = linear.get("mass", rig.plant.moving_mass)
    if "spring" in linear:
        out["spring_stiffness"] = linear["spring"]
    if "mass" in linear:
        out["moving_mass"] = mass
    out["gravity"] = linear["constant"] / mass
    return out


def _depends(name: str, fit: JointFit) -> bool:
    """Tell whether the fit moved a coefficient."""
    match name:
        case "static_force":
            return "static_rise" in fit.free or "coulomb_force" in fit.free
        case "viscous_coefficient" | "spring_stiffness" | "moving_mass" | "gravity":
            return True
        case _ if name.startswith("element_weight"):
            return fit.layout.elements > 1 and "element_stiffness_1" in fit.free
        case _:
            return name in fit.free


def _untouched(fit: JointFit) -> tuple[str, ...]:
    """Return the friction coefficients the fit left alone."""
    names = [name for name in ("stribeck_velocity", "stribeck_exponent", "attraction_rate") if name not in fit.free]
    if "element_stiffness_1" not in fit.free:
        names += ["element_stiffness", "element_weight"]
    return tuple(names)


def _rig_with(rig: Rig, fit: JointFit, values: Mapping[str, float]) -> Rig:
    friction = fit.friction._replace(viscous_coefficient=max(0.0, float(values["viscous_coefficient"])))
    if "element_stiffness_1" not in fit.free:
        kept = rig.friction
        friction = friction._replace(
            element_stiffness=kept.element_stiffness,
            element_weight=kept.element_weight,
            attraction_rate=kept.attraction_rate,
        )
    changed: dict[str, Any] = {n: float(values[n]) for n in ("spring_stiffness", "moving_mass") if n in values}
    if abs(values["gravity"]) < _GRAVITY_LIMIT:
        changed["gravity"] = float(values["gravity"])
    return rig._replace(plant=rig.plant._replace(**changed), friction=friction)


_GRAVITY_LIMIT = next(d.maximum for d in declarations(Plant) if d.name == "gravity") or 0.0


def _units() -> dict[str, str]:
    units = {d.name: d.unit for group in (Plant, Friction) for d in declarations(group)}
    return {**units, "element_stiffness": "N/m", "element_weight": "1"}
