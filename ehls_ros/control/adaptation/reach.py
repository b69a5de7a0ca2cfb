"""Check how far a controller's model of the rig departs from the rig file, with the bounds of adaptation for all sources.

A coefficient may change by a fraction of the rig file's value. If that is small or zero, as for a leakage, the fraction refers
to another value, at which the coefficient would take up all of the valve's flow or of the rig's force.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.control.companions import adaptation
from ehls_ros.control.controllers.base import Model
from ehls_ros.physics.parameters import Limits
from ehls_ros.schema import notes

REACH = notes(adaptation.Parameters)["reach"].maximum or 0.0
"""Largest change of a coefficient, relative to its value in the rig file."""


class Moved(NamedTuple):
    """Number of a model that differs from the rig file's.

    Attributes:
        name: name of the coefficient.
        value: value in the model.
        own: value in the rig file.
    """

    name: str
    value: float
    own: float


def check_reach(model: Model, own: Model, limits: Limits) -> None:
    """Check that a model is within reach of the rig file's.

    Args:
        model: the model that a controller is to use.
        own: the model of the rig file.
        limits: limits of the rig.

    Raises:
        ValueError: a coefficient is out of reach; the first is named.
    """
    if type(model.friction) is not type(own.friction):
        raise ValueError("it has another friction model")
    largest = sizes(own, limits)
    for moved in _moved(model, own):
        size = max(abs(moved.own), largest.get(moved.name, 0.0))
        # A zero delay has no relative change: its reach is one control cycle.
        reach = max(REACH * size, own.period if moved.name == "command_delay" else 0.0)
        if not abs(moved.value - moved.own) <= reach * (1.0 + 1e-9):
            share = f"{reach / size:.0%} of {size:.4g}" if size else "nothing"
            raise ValueError(f"{moved.name} is {moved.value:.4g}, the rig file's is {moved.own:.4g}: it may move by {share}")


def sizes(own: Model, limits: Limits) -> Mapping[str, float]:
    """Return the values at which coefficients would take up all flow or force, by name.

    Args:
        own: the model of the rig file.
        limits: limits of the rig.
    """
    plant = own.plant
    flow = plant.discharge_coefficient * plant.valve_area_gradient * own.spool_limit
    flow *= math.sqrt(plant.supply_pressure / plant.oil_density)
    low, high = limits.position
    damping = limits.force / limits.velocity
    found = {
        **dict.fromkeys(("leakage_coefficient", "leakage_a", "leakage_b"), flow / plant.supply_pressure),
        "spring_stiffness": limits.force / (high - low),
        "viscous_damping": damping,
        "viscous_coefficient": damping,
        "gravity": limits.force / plant.moving_mass,
    }
    return {name: size for name, size in found.items() if math.isfinite(size)}


def _moved(model: Model, own: Model) -> Iterator[Moved]:
    """Yield all numbers in which two models differ."""
    for field in Model._fields:
        given = _parts(field, getattr(own, field))
        for name, part in _parts(field, getattr(model, field)).items():
            yield from (Moved(name, *pair) for pair in _numbers(part, given[name]) if pair[0] != pair[1])


def _parts(field: str, value: Any) -> Mapping[str, Any]:
    """Return the parameters of a set by name, or a single value under the field's name."""
    parts: Mapping[str, Any] = value._asdict() if hasattr(value, "_asdict") else {field: value}
    return parts


def _numbers(value: Any, own: Any) -> Iterator[tuple[float, float]]:
    """Yield the numbers of a value paired with the rig file's; NaN if their counts differ."""
    values, given = np.atleast_1d(np.asarray(value, dtype=np.float64)), np.atleast_1d(np.asarray(own, dtype=np.float64))
    if values.shape != given.shape:
        yield math.nan, float(given.flat[0])
        return
    yield from zip(values.ravel().tolist(), given.ravel().tolist(), strict=True)
