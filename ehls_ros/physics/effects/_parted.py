"""A load parted from the piston: what hands the one's force on to the other."""

import math

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import ramp
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import Rig


@kernel
def contact(stretch: float, rate: float, gap: float, rounding: float, stiffness: float, damping: float) -> float:
    """Return the force across a play, its faces springs with dampers that act as far as they bear [N].

    Args:
        stretch: how far the piston is ahead of the load [m].
        rate: its rate [m/s].
        gap: play in all [m]; none: a spring.
        rounding: length over which the faces come to bear [m].
        stiffness: of the faces [N/m].
        damping: of the faces [N s/m].
    """
    if gap <= 0.0:
        return stiffness * stretch + damping * rate
    ahead, behind = ramp(stretch - 0.5 * gap, rounding), ramp(-stretch - 0.5 * gap, rounding)
    bears = 1.0 if rounding <= 0.0 else 1.0 - math.exp(-(ahead + behind) / rounding)
    if ahead + behind <= 0.0:
        return 0.0
    return stiffness * (ahead - behind) + damping * bears * rate


@kernel
def mass_of_piston(share: float, plant: Plant) -> float:
    """Return the mass that stays with the piston, from the load's and the piston's share of both [kg]."""
    return plant.moving_mass * share / (1.0 - share)


@kernel
def handed_on(value: float, pushed: float, share: float, y: Array, plant: Plant) -> float:
    """Return the force on the load beyond (3): what is handed on in the pressure's place, and the piston's weight."""
    return value + pushed - plant.piston_area * y[PL] - mass_of_piston(share, plant) * plant.gravity


@kernel
def piston_rates(pushed: float, share: float, y: Array, speed: float, load_speed: float, plant: Plant, dz: Array) -> None:
    """Write the rates of how far the piston is ahead of the load, and of its velocity."""
    dz[0] = speed - load_speed
    dz[1] = (plant.piston_area * y[PL] - pushed) / mass_of_piston(share, plant)


def without_piston(rig: Rig, share: float) -> Rig:
    """Return the rig with the load's fraction of the moving mass."""
    return rig._replace(plant=rig.plant._replace(moving_mass=(1.0 - share) * rig.plant.moving_mass))
