"""Joint between piston and a separated load, with play or elasticity."""

import math

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import ramp
from ehls_ros.physics.equations import piston_mass
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import Rig


@kernel
def contact(stretch: float, rate: float, gap: float, rounding: float, stiffness: float, damping: float) -> float:
    """Return the force across a play whose faces are springs and dampers [N].

    Args:
        stretch: displacement of the piston relative to the load [m].
        rate: rate of ``stretch`` [m/s].
        gap: total play [m]; 0: a spring and a damper without play.
        rounding: distance over which the contact of the faces builds up [m].
        stiffness: stiffness of the faces [N/m].
        damping: damping of the faces in full contact [N s/m].
    """
    if gap <= 0.0:
        return stiffness * stretch + damping * rate
    ahead, behind = ramp(stretch - 0.5 * gap, rounding), ramp(-stretch - 0.5 * gap, rounding)
    contact_fraction = 1.0 if rounding <= 0.0 else 1.0 - math.exp(-(ahead + behind) / rounding)
    if ahead + behind <= 0.0:
        return 0.0
    return stiffness * (ahead - behind) + damping * contact_fraction * rate


@kernel
def transmitted_force(value: float, joint_force: float, share: float, y: Array, plant: Plant) -> float:
    """Return ``value`` plus the joint's force in place of the pressure force of (3), and the piston's weight [N]."""
    return value + joint_force - plant.piston_area * y[PL] - piston_mass(share, plant) * plant.gravity


@kernel
def piston_rates(joint_force: float, share: float, y: Array, speed: float, load_speed: float, plant: Plant, dz: Array) -> None:
    """Write the rates of the piston's displacement relative to the load and of the piston's velocity."""
    dz[0] = speed - load_speed
    dz[1] = (plant.piston_area * y[PL] - joint_force) / piston_mass(share, plant)


def without_piston(rig: Rig, share: float) -> Rig:
    """Return the rig with its moving mass reduced to the load's share."""
    return rig.with_plant(moving_mass=(1.0 - share) * rig.plant.moving_mass)
