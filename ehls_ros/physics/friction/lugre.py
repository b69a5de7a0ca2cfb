"""LuGre friction: one bristle of stiffness Σ k_i whose force is the state; its mode is the direction of motion."""

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction.base import sign
from ehls_ros.physics.parameters import Friction

EQUATION = "dF/dt = σ0 (v - |v| F/s(v)), σ0 = Σ k_i; Ff = F + σf v"
SOURCE = "Canudas de Wit, Olsson, Åström, Lischinsky 1995, without the bristle damping σ1"


def states(p: Friction) -> int:
    """Return 1, the bristle."""
    return 1


@kernel
def rates(v: float, s: float, F: Array, mode: Array, p: Friction, rate: Array) -> None:
    """Deflect the bristle, relaxing toward s(v) in proportion to the distance travelled."""
    stiffness = 0.0
    for i in range(len(p.element_stiffness)):
        stiffness += p.element_stiffness[i]
    # mode v is |v|, and unlike it smooth where a step is tried beyond a reversal.
    rate[0] = stiffness * (v - mode[0] * v * F[0] / s)


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Return bristle plus viscous force."""
    return F[0] + p.viscous_coefficient * v


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Reversal, or the first motion."""
    return abs(v) if mode[0] == 0.0 else -mode[0] * v


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Note the direction of motion."""
    if mode[0] * v <= 0.0:
        mode[0] = sign(v)
    return v


@kernel
def begin(balance: float, s: float, p: Friction, F: Array) -> None:
    """Deflect the bristle, no further than it goes in steady motion."""
    F[0] = min(max(balance, -s), s)


def relaxation_rate(p: Friction, speed: float) -> float:
    """Return σ0 |v|/s with the lowest level."""
    return sum(p.element_stiffness) * speed / p.coulomb_force
