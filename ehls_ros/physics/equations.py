"""Equations (1) to (4) of the paper without friction: valve flow, volume balance, forces on the load, and spool."""

import math

from ehls_ros.arrays import kernel
from ehls_ros.physics.parameters import Plant

ATMOSPHERE = 101325.0
"""Atmospheric pressure p0, at which gauges read zero [Pa]."""

POLYTROPIC = 1.4
"""Polytropic exponent n of air compressed too fast for heat exchange."""


@kernel
def air_compliance(gauge: float) -> float:
    """Return the compliance per volume fraction of undissolved air at a gauge pressure, (p0/p)^(1/n)/(n p) [1/Pa].

    Merritt, Hydraulic Control Systems, 1967, ch. 2; the fraction is that at atmospheric pressure.
    """
    pressure = ATMOSPHERE + gauge
    return (ATMOSPHERE / pressure) ** (1.0 / POLYTROPIC) / (POLYTROPIC * pressure)


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


@kernel
def load_pressure_rate(
    load_flow: float, velocity: float, load_pressure: float, leakage: float, bulk_modulus: float, plant: Plant
) -> float:
    """Return the rate of the load pressure, equation (2) solved for it.

    Args:
        load_flow: QL [m^3/s].
        velocity: piston velocity [m/s].
        load_pressure: pL [Pa].
        leakage: leakage flow beyond the laminar Ctc pL [m^3/s].
        bulk_modulus: effective bulk modulus [Pa].
        plant: the rig's coefficients.

    Returns:
        dpL/dt [Pa/s].
    """
    stored = load_flow - plant.piston_area * velocity - plant.leakage_coefficient * load_pressure - leakage
    return 4.0 * bulk_modulus / plant.total_volume * stored  # (2)


@kernel
def applied_force(
    position: float, velocity: float, load_pressure: float, disturbance: float, extra: float, plant: Plant
) -> float:
    """Return the force on the moving mass without friction.

    Args:
        position: piston position [m].
        velocity: piston velocity [m/s].
        load_pressure: pL [Pa].
        disturbance: disturbance force fd [N].
        extra: force of the effects [N].
        plant: the rig's coefficients.

    Returns:
        Force along +x [N]. As in (3), a positive ``gravity`` acts along -x.
    """
    return (
        plant.piston_area * load_pressure
        - plant.viscous_damping * velocity
        - plant.spring_stiffness * position
        - plant.moving_mass * plant.gravity
        - disturbance
        + extra
    )  # (3)


@kernel
def piston_mass(share: float, plant: Plant) -> float:
    """Return the mass of a piston separate from the load [kg].

    Args:
        share: the piston's fraction of the total moving mass.
        plant: the rig's coefficients; their moving mass is that of the load alone.
    """
    return plant.moving_mass * share / (1.0 - share)
