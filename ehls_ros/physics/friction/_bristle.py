"""What models of one bristle share: its force is the state, its mode the direction of motion."""

from collections.abc import Mapping
from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction.base import sign


def derived(others: Mapping[str, Any]) -> dict[str, Any]:
    """Take for the bristle's stiffness that of all elements of another model together."""
    total = 0.0
    for stiffness in others.get("element_stiffness", ()):
        total += stiffness
    return {"presliding_stiffness": total} if total > 0.0 else {}


def states(p: Any) -> int:
    """Return 1, the bristle."""
    return 1


def stiffness(p: Any) -> float:
    """Return the bristle's stiffness."""
    return float(p.presliding_stiffness)


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
    """Return bristle plus viscous force."""
    return F[0] + p.viscous_coefficient * v


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
    """Return the motion before the first direction is known, then the motion against it."""
    return abs(v) if mode[0] == 0.0 else -mode[0] * v


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
    """Note the direction of motion."""
    if mode[0] * v <= 0.0:
        mode[0] = sign(v)
    return v


@kernel
def begin(balance: float, s: float, p: Any, F: Array) -> None:
    """Let the bristle hold the balance."""
    F[0] = min(max(balance, -s), s)
