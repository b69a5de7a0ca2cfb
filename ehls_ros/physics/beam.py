"""Beam load: the forces of equation (3) without friction."""

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
