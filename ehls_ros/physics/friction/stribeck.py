"""Static Stribeck friction with true standstill: while sticking, it balances the applied force."""

import math
from typing import NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction.base import (
    CoulombForce,
    StaticForce,
    StribeckExponent,
    StribeckVelocity,
    ViscousCoefficient,
    check_stribeck,
    sign,
    stribeck_level,
)

EQUATION = "slip: Ff = sgn(v) s(v) + σf v; stick (v = 0): Ff = applied force, up to Fs"
SOURCE = "Stribeck 1902; stick as in Karnopp 1985, with located events in place of the dead band"


class Parameters(NamedTuple):
    """The Stribeck curve."""

    coulomb_force: CoulombForce
    static_force: StaticForce
    stribeck_velocity: StribeckVelocity
    stribeck_exponent: StribeckExponent
    viscous_coefficient: ViscousCoefficient


check, level = check_stribeck, stribeck_level


def states(p: Parameters) -> int:
    """Return 1, for the contact; only its mode is used."""
    return 1


def stiffness(p: Parameters) -> float:
    """Return infinity, as the contact is rigid [N/m]."""
    return math.inf


def break_away(p: Parameters) -> float:
    """Return 0, as the contact is rigid [m]."""
    return 0.0


@kernel
def rates(v: float, s: float, F: Array, mode: Array, p: Parameters, rate: Array) -> None:
    """Write 0, as the model is static."""
    rate[0] = 0.0


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Parameters) -> float:
    """Return the sliding force, or the applied force at standstill [N]."""
    if mode[0] == 0.0:
        return applied
    return mode[0] * s + p.viscous_coefficient * v


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Parameters) -> float:
    """Return the excess of the applied force over s(0) = Fs, or the velocity against the direction of slip."""
    if mode[0] == 0.0:
        return abs(applied) - s
    return -mode[0] * v


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Parameters) -> float:
    """Break away in the direction of the applied force; stop at a reversal, unless that force exceeds Fs."""
    if mode[0] == 0.0:
        if abs(applied) > s:
            mode[0] = sign(applied)
        return 0.0
    if mode[0] * v < 0.0:
        mode[0] = sign(applied) if abs(applied) > s else 0.0
        return 0.0
    return v


def relaxation_rate(p: Parameters, speed: float) -> float:
    """Return 0, as the model has no dynamics [1/s]."""
    return 0.0


@kernel
def begin(balance: float, s: float, p: Parameters, F: Array) -> None:
    """Write 0, as a sticking contact balances the applied force without a state."""
    F[0] = 0.0
