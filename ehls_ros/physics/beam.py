"""Beam load: everything but friction that acts on the piston, equation (3)."""

from ehls_ros.arrays import kernel
from ehls_ros.physics.parameters import Plant


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
        extra: what effects add [N].
        plant: the rig's coefficients.

    Returns:
        Force along +x [N]. Gravity keeps the sign of (3): it pulls along -x for a positive ``gravity``.
    """
    return (
        plant.piston_area * load_pressure
        - plant.viscous_damping * velocity
        - plant.spring_stiffness * position
        - plant.moving_mass * plant.gravity
        - disturbance
        + extra
    )  # (3)
