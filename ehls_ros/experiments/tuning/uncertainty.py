"""Rigs as they may be within the uncertainty of a rig file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ehls_ros.experiments.spec import COUPLING, Spec
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.physics.rig import Rig

ASSUMED: Mapping[str, float] = {
    "plant.supply_pressure": 0.02,
    "plant.bulk_modulus": 0.1,
    "plant.discharge_coefficient": 0.05,
    "plant.leakage_coefficient": 0.5,
    "plant.moving_mass": 0.05,
    "plant.piston_area": 0.01,
    "plant.spring_stiffness": 0.05,
    "plant.valve_bandwidth": 0.1,
    "friction.coulomb_force": 0.1,
    "friction.static_force": 0.1,
    "friction.viscous_coefficient": 0.2,
    "friction.element_stiffness": 0.2,
    f"effects.{COUPLING}.stiffness": 0.1,
}
"""Relative standard error of a coefficient whose file has none."""

LIMIT = 2.0
"""Largest deviation of a drawn coefficient, in standard errors."""

MIN_FACTOR = 0.2
"""Smallest factor on a coefficient."""


def relative_errors(rig: Rig) -> dict[str, float]:
    """Return the relative standard errors of a rig's coefficients: its file's where it has them, else :data:`ASSUMED`."""
    stated = {path: std for path, std in rig.standard_errors.items() if path in ASSUMED and read(rig, path) != 0.0}
    return {**ASSUMED, **{path: std / abs(read(rig, path)) for path, std in stated.items()}}


def uncertain(specs: Sequence[Spec], seed: int, scale: float = 1.0) -> list[Spec]:
    """Return experiments each on a rig within the uncertainty of the controller's rig, which stays as it is.

    Args:
        specs: the experiments on the rig of the file.
        seed: seed of the draws and of the sensors' noise.
        scale: factor on all standard errors.
    """
    return [_drawn(spec, relative_errors(spec.controller_rig), scale, seed + 1 + number) for number, spec in enumerate(specs)]


def _drawn(spec: Spec, errors: Mapping[str, float], scale: float, seed: int) -> Spec:
    random = np.random.default_rng(seed)
    factors = {
        path: max(1.0 + scale * error * float(np.clip(random.standard_normal(), -LIMIT, LIMIT)), MIN_FACTOR)
        for path, error in errors.items()
    }
    moved = _section(factors, f"effects.{COUPLING}")
    coupled = spec.disturbance.parameters
    if "stiffness" in getattr(coupled, "_fields", ()) and "stiffness" in moved:
        coupled = coupled._replace(stiffness=coupled.stiffness * moved["stiffness"])
    return spec._replace(
        rig=_moved(spec.rig, factors),
        disturbance=spec.disturbance._replace(parameters=coupled),
        settings=spec.settings._replace(seed=seed),
    )


def _moved(rig: Rig, factors: Mapping[str, float]) -> Rig:
    plant, friction = _section(factors, "plant"), _section(factors, "friction")
    return rig._replace(plant=_scaled(rig.plant, plant), friction=_scaled(rig.friction, friction))


def _scaled(numbers: Any, factors: Mapping[str, float]) -> Any:
    present = {name: getattr(numbers, name) for name in factors if name in numbers._fields}
    return numbers._replace(
        **{
            name: tuple(each * factors[name] for each in value) if isinstance(value, tuple) else value * factors[name]
            for name, value in present.items()
        }
    )


def _section(factors: Mapping[str, float], section: str) -> dict[str, float]:
    prefix = f"{section}."
    return {path.removeprefix(prefix): factor for path, factor in factors.items() if path.startswith(prefix)}
