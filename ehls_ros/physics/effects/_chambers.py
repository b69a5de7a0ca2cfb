"""Pressures of the two chambers, of which the model knows but the difference."""

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL

ATMOSPHERE = 101325.0
"""Pressure at which oil stands and gauges read zero [Pa]."""


@kernel
def chambers(y: Array, plant: Plant) -> tuple[float, float]:
    """Return the gauge pressures behind a matched, symmetric valve, none below zero; ps is the rig file's [Pa].

    Args:
        y: the plant's state.
        plant: the rig's coefficients.

    Returns:
        (ps + pL)/2 of the chamber that drives +x, (ps - pL)/2 of the other.
    """
    return max(0.5 * (plant.supply_pressure + y[PL]), 0.0), max(0.5 * (plant.supply_pressure - y[PL]), 0.0)
