"""Generalised Maxwell slip friction.

(8) as printed holds sgn(v) outside the bracket and diverges for v < 0; the form here has the steady
state (9). An element breaks away in the direction of motion only: the printed |F_i| >= alpha_i s(v)
would let an element that is being unloaded slip against the motion.
"""

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction.base import sign
from ehls_ros.physics.parameters import Friction

EQUATION = "stick: dF_i/dt = k_i v; slip: dF_i/dt = C (sgn(v) α_i - F_i/s(v)); Ff = Σ F_i + σf v"
SOURCE = "Kang et al. 2018, (5)-(9); Al-Bender, Lampaert, Swevers 2005"


def states(p: Friction) -> int:
    """Return the number of elements."""
    return len(p.element_stiffness)


@kernel
def rates(v: float, s: float, F: Array, mode: Array, p: Friction, rate: Array) -> None:
    """Stick follows (6), slip (8)."""
    for i in range(len(p.element_stiffness)):
        if mode[i] == 0.0:
            rate[i] = p.element_stiffness[i] * v  # (6)
        else:
            rate[i] = p.attraction_rate * (mode[i] * p.element_weight[i] - F[i] / s)  # (8)


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Return (5)."""
    total = p.viscous_coefficient * v
    for i in range(len(p.element_stiffness)):
        total += F[i]
    return total  # (5)


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Break-away of a sticking element, or reversal under a slipping one."""
    largest = -np.inf
    direction = sign(v)
    for i in range(len(p.element_stiffness)):
        value = direction * F[i] - p.element_weight[i] * s if mode[i] == 0.0 else -mode[i] * v
        largest = max(largest, value)
    return largest


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
    """Let break away, or hold at the reversal."""
    direction = sign(v)
    for i in range(len(p.element_stiffness)):
        if mode[i] == 0.0:
            if direction * F[i] - p.element_weight[i] * s > 0.0:
                mode[i] = direction
        elif mode[i] * v < 0.0:
            mode[i] = 0.0
    return v


@kernel
def begin(balance: float, s: float, p: Friction, F: Array) -> None:
    """Share the force out by weight, none beyond its break-away."""
    total = 0.0
    for i in range(len(p.element_weight)):
        total += p.element_weight[i]
    for i in range(len(p.element_weight)):
        F[i] = min(max(balance, -s), s) * (p.element_weight[i] / total)


def relaxation_rate(p: Friction, speed: float) -> float:
    """Return 0: C/s is slow beside any sampling."""
    return 0.0
