"""What a friction model provides, and the Stribeck curve they share.

A model has ``states(friction)`` forces F [N] that follow the velocity, and as many modes. A mode is 0
while the contact sticks and +1 or -1 while it slips that way; it changes only at an event that the
integrator locates, so that between events everything is smooth. The functions are compiled by numba;
their arguments, the same for all:

* ``v`` velocity [m/s]; ``s`` Stribeck level s(v) [N], effects included; ``F`` forces of the elements [N];
* ``mode`` modes of the elements; ``p`` the rig's :class:`~ehls_ros.physics.rig.Friction`;
* ``applied`` every other force on the mass [N]; ``rate`` where the derivatives of F go [N/s].

``relaxation_rate`` alone is called from Python and not compiled.
"""

import math
from typing import Protocol

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Friction


class FrictionModel(Protocol):
    """The functions of one friction model's file."""

    EQUATION: str
    SOURCE: str

    def states(self, p: Friction) -> int:
        """Return how many forces the model integrates."""

    def rates(self, v: float, s: float, F: Array, mode: Array, p: Friction, rate: Array) -> None:
        """Write the derivatives of the forces into ``rate``."""

    def force(self, v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
        """Return the friction force opposing +v [N]."""

    def event(self, v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
        """Return a function of the state that is positive once a mode has to change."""

    def switch(self, v: float, applied: float, s: float, F: Array, mode: Array, p: Friction) -> float:
        """Change the modes whose event has come and return the velocity after it."""

    def begin(self, balance: float, s: float, p: Friction, F: Array) -> None:
        """Write forces that together balance a force [N] as far as they can: a start where nobody knows the history."""

    def relaxation_rate(self, p: Friction, speed: float) -> float:
        """Return how fast the forces relax at a speed [m/s] that is passed quickly [1/s]; 0 where that is never stiff."""


@kernel
def stribeck_level(v: float, p: Friction) -> float:
    """Return s(v) of equation (7) [N], the steady friction without its viscous part."""
    return p.coulomb_force + (p.static_force - p.coulomb_force) * math.exp(
        -(abs(v / p.stribeck_velocity) ** p.stribeck_exponent)
    )  # (7)


@kernel
def sign(value: float) -> float:
    """Return 1, -1, or 0 for 0."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)
