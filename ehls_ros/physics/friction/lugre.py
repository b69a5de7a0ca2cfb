"""LuGre friction: one bristle of stiffness Σ k_i whose force is the state."""

import numpy as np
from ehls_ros.arrays import Array, kernel
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
    rate[0] = stiffness * (v - abs(v) * F[0] / s)


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Return bristle plus viscous force."""
    return F[0] + p.viscous_coefficient * v


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Nothing switches."""
    return -np.inf


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Nothing switches."""
    return v
