"""LuGre friction: one bristle that relaxes towards the Stribeck curve with the distance travelled."""

from typing import NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction._bristle import begin, derived, event, force, states, stiffness, switch
from ehls_ros.physics.friction.base import (
    CoulombForce,
    PreslidingStiffness,
    StaticForce,
    StribeckExponent,
    StribeckVelocity,
    ViscousCoefficient,
    check_stribeck,
    stribeck_level,
)

__all__ = ["begin", "derived", "event", "force", "states", "stiffness", "switch"]

EQUATION = "dF/dt = σ0 (v - |v| F/s(v)); Ff = F + σf v"
SOURCE = "Canudas de Wit, Olsson, Åström, Lischinsky 1995, without the bristle damping σ1"


class Parameters(NamedTuple):
    """Stribeck curve and bristle."""

    coulomb_force: CoulombForce
    static_force: StaticForce
    stribeck_velocity: StribeckVelocity
    stribeck_exponent: StribeckExponent
    viscous_coefficient: ViscousCoefficient
    presliding_stiffness: PreslidingStiffness


check, level = check_stribeck, stribeck_level


def break_away(p: Parameters) -> float:
    """Return the travel over which a bristle of constant stiffness reaches Fs [m]."""
    return p.static_force / p.presliding_stiffness


@kernel
def rates(v: float, s: float, F: Array, mode: Array, p: Parameters, rate: Array) -> None:
    """Write the rate of the bristle force."""
    # mode v is |v|, but stays smooth when a trial step passes a reversal.
    rate[0] = p.presliding_stiffness * (v - mode[0] * v * F[0] / s)


def relaxation_rate(p: Parameters, speed: float) -> float:
    """Return σ0 |v|/Fc [1/s]."""
    return p.presliding_stiffness * abs(speed) / p.coulomb_force
