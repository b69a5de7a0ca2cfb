"""Common functions of single-bristle models: the state is the bristle force, the mode the direction of motion."""

from collections.abc import Mapping
from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction.base import sign


def derived(others: Mapping[str, Any]) -> dict[str, Any]:
    """Return the bristle's stiffness as the sum of another model's element stiffnesses."""
    total = 0.0
    for stiffness in others.get("element_stiffness", ()):
        total += stiffness
    return {"presliding_stiffness": total} if total > 0.0 else {}


def states(p: Any) -> int:
    """Return 1, for the bristle."""
    return 1


def stiffness(p: Any) -> float:
    """Return the bristle's stiffness [N/m]."""
    return float(p.presliding_stiffness)


@kernel
def force(v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
    """Return bristle force plus viscous force [N]."""
    return F[0] + p.viscous_coefficient * v


@kernel
def event(v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
    """Return the speed before the first motion, afterwards the velocity against the direction of motion [m/s]."""
    return abs(v) if mode[0] == 0.0 else -mode[0] * v


@kernel
def switch(v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
    """Set the mode to the direction of motion."""
    if mode[0] * v <= 0.0:
        mode[0] = sign(v)
    return v


@kernel
def begin(balance: float, s: float, p: Any, F: Array) -> None:
    """Initialise the bristle force to the balance, limited to the level s."""
    F[0] = min(max(balance, -s), s)
