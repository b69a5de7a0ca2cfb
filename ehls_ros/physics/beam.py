"""Beam load: forces of equation (3) without friction, and masses."""

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


@kernel
def piston_mass(share: float, plant: Plant) -> float:
    """Return the mass of a piston separate from the load [kg].

    Args:
        share: the piston's fraction of the total moving mass.
        plant: the rig's coefficients; their moving mass is that of the load alone.
    """
    return plant.moving_mass * share / (1.0 - share)
