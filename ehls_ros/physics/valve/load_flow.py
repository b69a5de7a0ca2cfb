"""Valve of the paper: matched, symmetric edges without overlap, as one load flow."""

from typing import NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.equations import load_flow

__all__ = ["load_flow"]

EQUATION = "QL = Cd w xv √((ps - sgn(xv) pL)/ρ) (1)"
SOURCE = "Kang et al. 2018, equation (1)"
MODES = 1


class Parameters(NamedTuple):
    """No keys beyond those of ``plant``."""


def check(p: Parameters, where: str) -> None:
    """Accept every valve."""


@kernel
def event(opening: float, mode: Array, p: Parameters) -> float:
    """Return a positive value once the opening has the other sign than the mode."""
    return -mode[0] * opening


@kernel
def switch(opening: float, mode: Array, p: Parameters) -> None:
    """Change the sign of the opening."""
    if -mode[0] * opening > 0.0:
        mode[0] = -mode[0]
