"""Interface of the file of a friction model, and common functions.

A model has a force F [N] and a mode for each element. The mode is 0 while the element sticks, and +1 or -1 while it slips in
that direction. It changes only at an event that the integrator locates, so the equations are smooth between events.

A file has ``EQUATION``, ``SOURCE`` and ``Parameters``, a named tuple that declares the keys of the rig file's ``friction``
section. Every model has the key ``viscous_coefficient``; keys that several models have are declared here. These functions
are called from Python before a run:

* ``check(p, where)`` raises :class:`~ehls_ros.errors.BadInput` if keys contradict each other;
* ``states(p)`` returns the number of elements;
* ``stiffness(p)`` returns the stiffness of the contact at rest [N/m], infinite if it is rigid;
* ``break_away(p)`` returns the travel from rest until the whole contact slips [m], 0 if it is rigid;
* ``relaxation_rate(p, speed)`` returns the largest rate at which forces approach steady sliding at a speed [m/s], in 1/s.

The other functions are compiled:

* ``level(v, p)`` returns the friction of steady sliding without its viscous part [N], the Stribeck level: positive and even
  in v; at v = 0 it is the break-away force;
* ``rates(v, s, F, mode, p, rate)`` writes the derivatives of F to ``rate`` [N/s];
* ``force(v, applied, s, F, mode, p)`` returns the friction force against +v [N]; at given F, s and modes it depends on v
  through the viscous term alone;
* ``event(v, applied, s, F, mode, p)`` returns an event function, which turns positive when a mode must change;
* ``switch(v, applied, s, F, mode, p)`` changes the modes at the event and returns the velocity after it [m/s];
* ``begin(balance, s, p, F)`` writes to F the forces that hold a balance [N], limited to the level s.

Their arguments: ``v`` velocity [m/s]; ``s`` level(v, p) with the effects on it [N]; ``applied`` the sum of all other forces
on the mass [N], which only a contact that is rigid at rest may use; ``p`` the rig's ``Parameters``.

A file may have ``derived(others)``, which returns those of its keys that follow from keys of other models; they apply if the
rig file omits them.
"""

from typing import Annotated, Any, Protocol

from ehls_ros.arrays import Array, kernel
from ehls_ros.errors import BadInput
from ehls_ros.physics.vector_math import stretched_decay
from ehls_ros.schema import quantity

CoulombForce = Annotated[float, quantity("N", "Coulomb friction Fc", above=0.0, maximum=1e9)]
StaticForce = Annotated[float, quantity("N", "static friction Fs", above=0.0, maximum=1e9)]
StribeckVelocity = Annotated[float, quantity("m/s", "Stribeck velocity Vs", above=0.0, maximum=1e3)]
StribeckExponent = Annotated[float, quantity("1", "shape of the Stribeck curve, delta", above=0.0, maximum=4.0)]
ViscousCoefficient = Annotated[float, quantity("N s/m", "viscous friction sigma_f", minimum=0.0, maximum=1e20)]
PreslidingStiffness = Annotated[float, quantity("N/m", "stiffness of the contact at rest, sigma_0", above=0.0, maximum=1e20)]


class FrictionModel(Protocol):
    """The attributes of a friction model's file; ``derived`` is optional."""

    EQUATION: str
    SOURCE: str
    Parameters: Any

    def check(self, p: Any, where: str) -> None:
        """Raise BadInput if keys contradict each other."""

    def states(self, p: Any) -> int:
        """Return the number of elements."""

    def stiffness(self, p: Any) -> float:
        """Return the stiffness of the contact at rest [N/m]."""

    def break_away(self, p: Any) -> float:
        """Return the travel from rest until the whole contact slips [m]."""

    def relaxation_rate(self, p: Any, speed: float) -> float:
        """Return the largest rate at which forces approach steady sliding at a speed [m/s], in 1/s."""

    def level(self, v: float, p: Any) -> float:
        """Return the friction of steady sliding without its viscous part, the Stribeck level [N]."""

    def rates(self, v: float, s: float, F: Array, mode: Array, p: Any, rate: Array) -> None:
        """Write the derivatives of the forces to ``rate`` [N/s]."""

    def force(self, v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
        """Return the friction force against +v [N]."""

    def event(self, v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
        """Return an event function, which turns positive when a mode must change."""

    def switch(self, v: float, applied: float, s: float, F: Array, mode: Array, p: Any) -> float:
        """Change the modes at the event and return the velocity after it [m/s]."""

    def begin(self, balance: float, s: float, p: Any, F: Array) -> None:
        """Write the forces that hold a balance [N] to ``F``, limited to the level s."""


@kernel
def stribeck_level(v: float, p: Any) -> float:
    """Return the Stribeck curve s(v) of equation (7) [N]."""
    decay = stretched_decay(abs(v / p.stribeck_velocity), p.stribeck_exponent)
    return p.coulomb_force + (p.static_force - p.coulomb_force) * decay  # (7)


def check_stribeck(p: Any, where: str) -> None:
    """Raise BadInput if the Coulomb friction exceeds the static friction."""
    if p.coulomb_force > p.static_force:
        raise BadInput(f"coulomb_force is {p.coulomb_force:g}", where, f"at most static_force = {p.static_force:g} N")


@kernel
def sign(value: float) -> float:
    """Return 1 for a positive value, -1 for a negative one, and 0 for 0."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)
