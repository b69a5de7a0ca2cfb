"""Pressures of the two chambers; the model state contains only their difference."""

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL

ATMOSPHERE = 101325.0
"""Atmospheric pressure, at which gauges read zero [Pa]."""


@kernel
def chambers(y: Array, plant: Plant) -> tuple[float, float]:
    """Return the gauge pressures of both chambers, at least 0, for a matched, symmetric valve and the rig file's ps [Pa].

    Args:
        y: the plant's state.
        plant: the rig's coefficients.

    Returns:
        (ps + pL)/2 for the chamber that drives +x, (ps - pL)/2 for the other.
    """
    return max(0.5 * (plant.supply_pressure + y[PL]), 0.0), max(0.5 * (plant.supply_pressure - y[PL]), 0.0)
