"""Servo valve: orifice flow (1) and spool dynamics (4)."""

import math

from ehls_ros.arrays import kernel
from ehls_ros.physics.parameters import Plant


@kernel
def load_flow(opening: float, direction: float, load_pressure: float, supply_pressure: float, plant: Plant) -> float:
    """Return the load flow QL of equation (1).

    Args:
        opening: effective spool displacement [m].
        direction: sign of the opening, 1 or -1, from the mode; it is constant within a step.
        load_pressure: pL [Pa]; beyond the supply pressure the flow reverses.
        supply_pressure: ps [Pa].
        plant: the rig's coefficients.

    Returns:
        QL [m^3/s].
    """
    drop = supply_pressure - direction * load_pressure
    root = math.sqrt(abs(drop) / plant.oil_density)
    return plant.discharge_coefficient * plant.valve_area_gradient * opening * math.copysign(root, drop)  # (1)


@kernel
def spool_rate(spool: float, command: float, plant: Plant) -> float:
    """Return the spool velocity of equation (4) [m/s] from spool and command [m]."""
    return plant.valve_bandwidth * (plant.valve_gain * command - spool)  # (4)
