"""Dahl friction: one bristle that softens towards the Coulomb force and regains its stiffness at a reversal."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction._bristle import begin, derived, event, force, states, stiffness, switch
from ehls_ros.physics.friction.base import CoulombForce, PreslidingStiffness, ViscousCoefficient
from ehls_ros.schema import quantity

__all__ = ["begin", "derived", "event", "force", "states", "stiffness", "switch"]

EQUATION = "dF/dt = σ0 |1 - F sgn(v)/Fc|^i sgn(1 - F sgn(v)/Fc) v; Ff = F + σf v"
SOURCE = "Dahl, A solid friction model, 1968; Solid friction damping of mechanical vibrations, AIAA Journal 14, 1976"


class Parameters(NamedTuple):
    """Coulomb friction and presliding; the viscous term is not part of Dahl's model."""

    coulomb_force: CoulombForce
    viscous_coefficient: ViscousCoefficient
    presliding_stiffness: PreslidingStiffness
    softening_exponent: Annotated[
        float, quantity("1", "exponent of the bristle's softening towards the Coulomb force, i", minimum=1.0, maximum=4.0)
    ] = 1.0


def check(p: Parameters, where: str) -> None:
    """Accept all parameters: no key constrains another."""


def break_away(p: Parameters) -> float:
    """Return the travel over which a bristle of constant stiffness reaches Fc [m]."""
    return p.coulomb_force / p.presliding_stiffness


@kernel
def level(v: float, p: Parameters) -> float:
    """Return Fc at any velocity [N]."""
    return p.coulomb_force


@kernel
def rates(v: float, s: float, F: Array, mode: Array, p: Parameters, rate: Array) -> None:
    """Write the rate of the bristle force."""
    # In motion the mode is sgn(v); before the first motion F is 0.
    margin = 1.0 - mode[0] * F[0] / s
    softening = margin if p.softening_exponent == 1.0 else abs(margin) ** (p.softening_exponent - 1.0) * margin
    rate[0] = p.presliding_stiffness * softening * v


def relaxation_rate(p: Parameters, speed: float) -> float:
    """Return i 2^(i-1) σ0 |v|/Fc [1/s], the rate just after a reversal from full slip, when F sgn(v) = -Fc."""
    steepest = p.softening_exponent * 2.0 ** (p.softening_exponent - 1.0)
    return steepest * p.presliding_stiffness * abs(speed) / p.coulomb_force
