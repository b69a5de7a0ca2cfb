"""Static Stribeck friction with true standstill: while it sticks it balances what is applied."""

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction.base import sign
from ehls_ros.physics.parameters import Friction

EQUATION = "slip: Ff = sgn(v) s(v) + σf v; stick (v = 0): Ff = applied force, up to Fs"
SOURCE = "Stribeck 1902; stick as Karnopp 1985, with located events in place of the dead band"


def states(p: Friction) -> int:
    """Return 1, the friction force itself, kept as a mode only."""
    return 1


@kernel
def rates(v: float, s: float, F: Array, mode: Array, p: Friction, rate: Array) -> None:
    """Keep the state at rest: the law is static."""
    rate[0] = 0.0


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Return the slipping force, or the balance at standstill."""
    if mode[0] == 0.0:
        return applied
    return mode[0] * s + p.viscous_coefficient * v


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Break-away at s(0) = Fs, or reversal."""
    if mode[0] == 0.0:
        return abs(applied) - s
    return -mode[0] * v


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Break away along the applied force; stop, or go on the other way where that force is larger than Fs."""
    if mode[0] == 0.0:
        if abs(applied) > s:
            mode[0] = sign(applied)
        return 0.0
    if mode[0] * v < 0.0:
        mode[0] = sign(applied) if abs(applied) > s else 0.0
        return 0.0
    return v


@kernel
def begin(balance: float, s: float, p: Friction, F: Array) -> None:
    """Leave the state at zero: the law is static."""
    F[0] = 0.0


def relaxation_rate(p: Friction, speed: float) -> float:
    """Return 0: there is nothing that relaxes."""
    return 0.0
