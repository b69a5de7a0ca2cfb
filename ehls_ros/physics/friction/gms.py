"""Generalised Maxwell slip friction.

(8) as printed has sgn(v) outside the bracket and diverges for v < 0; the form used here has the steady state (9). An element
breaks away only in the direction of motion: with the printed |F_i| >= alpha_i s(v), an element that is being unloaded could
slip against the motion.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.errors import BadInput
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
from ehls_ros.schema import quantity, text

EQUATION = "stick: dF_i/dt = k_i v; slip: dF_i/dt = C (sgn(v) α_i - F_i/s(v)); Ff = Σ F_i + σf v"
SOURCE = "Kang et al. 2018, (5)-(9); Al-Bender, Lampaert, Swevers 2005"


class Parameters(NamedTuple):
    """Stribeck curve and elements, equations (5)-(8)."""

    coulomb_force: CoulombForce
    static_force: StaticForce
    stribeck_velocity: StribeckVelocity
    stribeck_exponent: StribeckExponent
    viscous_coefficient: ViscousCoefficient
    element_stiffness: Annotated[tuple[float, ...], text("presliding stiffness k_i of each element", "N/m")]
    element_weight: Annotated[tuple[float, ...], text("weight alpha_i of each element; the weights sum to 1", "1")]
    attraction_rate: Annotated[
        float, quantity("N/s", "rate C at which a slipping element approaches the Stribeck curve", above=0.0, maximum=1e20)
    ]


level = stribeck_level

MAX_ELEMENTS = 64
"""Largest number of elements; the compile time of the equations grows with it."""


def check(p: Parameters, where: str) -> None:
    """Raise BadInput if the elements' lists do not match or are too long, or if Coulomb exceeds static friction."""
    if not p.element_stiffness or len(p.element_stiffness) != len(p.element_weight):
        what = f"{len(p.element_stiffness)} element_stiffness and {len(p.element_weight)} element_weight"
        raise BadInput(what, where, "lists of the same length, with at least one element")
    if len(p.element_stiffness) > MAX_ELEMENTS:
        raise BadInput(f"element_stiffness has {len(p.element_stiffness)} values", where, f"at most {MAX_ELEMENTS}")
    for key, values in (("element_stiffness", p.element_stiffness), ("element_weight", p.element_weight)):
        if not all(0.0 < value < math.inf for value in values):
            raise BadInput(f"{key} is {list(values)}", where, "finite numbers above 0")
    if abs(sum(p.element_weight) - 1.0) > 1e-6:
        raise BadInput(f"element_weight sums to {sum(p.element_weight):g}", where, "a sum of 1")
    check_stribeck(p, where)


def states(p: Parameters) -> int:
    """Return the number of elements."""
    return len(p.element_stiffness)


def stiffness(p: Parameters) -> float:
    """Return the sum of the elements' stiffnesses [N/m]."""
    return float(sum(p.element_stiffness))


def break_away(p: Parameters) -> float:
    """Return the travel after which the last element slips [m]."""
    return max(p.static_force * weight / k for weight, k in zip(p.element_weight, p.element_stiffness, strict=True))


@kernel
def rates(v: float, s: float, F: Array, mode: Array, p: Parameters, rate: Array) -> None:
    """Write the force rates (6) of sticking elements and (8) of slipping ones."""
    relative = 1.0 / s
    for i in range(len(p.element_stiffness)):
        if mode[i] == 0.0:
            rate[i] = p.element_stiffness[i] * v  # (6)
        else:
            rate[i] = p.attraction_rate * (mode[i] * p.element_weight[i] - F[i] * relative)  # (8)


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Parameters) -> float:
    """Return the friction force (5) [N]."""
    total = p.viscous_coefficient * v
    for i in range(len(p.element_stiffness)):
        total += F[i]
    return total  # (5)


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Parameters) -> float:
    """Return the largest of the sticking elements' excess over break-away and the velocity against the slipping ones."""
    largest = -np.inf
    direction = sign(v)
    for i in range(len(p.element_stiffness)):
        value = direction * F[i] - p.element_weight[i] * s if mode[i] == 0.0 else -mode[i] * v
        largest = max(largest, value)
    return largest


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Parameters) -> float:
    """Release elements that break away, and make slipping ones stick at a reversal."""
    direction = sign(v)
    for i in range(len(p.element_stiffness)):
        if mode[i] == 0.0:
            if direction * F[i] - p.element_weight[i] * s > 0.0:
                mode[i] = direction
        elif mode[i] * v < 0.0:
            mode[i] = 0.0
    return v


def relaxation_rate(p: Parameters, speed: float) -> float:
    """Return C/Fc [1/s], the rate of a slipping element at high speed."""
    return p.attraction_rate / p.coulomb_force


@kernel
def begin(balance: float, s: float, p: Parameters, F: Array) -> None:
    """Divide the balance, limited to the level s, among the elements by their weights."""
    total = 0.0
    for i in range(len(p.element_weight)):
        total += p.element_weight[i]
    for i in range(len(p.element_weight)):
        F[i] = min(max(balance, -s), s) * (p.element_weight[i] / total)
