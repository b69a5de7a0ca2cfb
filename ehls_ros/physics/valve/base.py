"""Interface of the file of a valve.

A file has ``EQUATION``, ``SOURCE``, ``Parameters``, a named tuple that declares the keys of the rig file's ``valve`` section,
and ``MODES``, the number of its modes. The spool's dynamics (4), the flow coefficient Cd, the area gradient w and the gain Kv
are those of ``plant``. ``check(p, where)`` raises :class:`~ehls_ros.errors.BadInput` if keys contradict each other.

The other functions are compiled. A file has one or both of

* ``load_flow(opening, direction, load_pressure, supply_pressure, plant)``, the load flow [m^3/s] of a valve whose edges are
  one (:func:`ehls_ros.physics.equations.load_flow`);
* ``chamber_flows(opening, supply, a, b, tank, p, plant)``, the flows into chamber A, into chamber B and from the supply
  [m^3/s] at pressures of P, A, B and T [Pa]; and ``slope(p, plant, flow)``, called from Python: the largest change of the
  flow through an edge per pressure [m^3/(s Pa)] while the valve passes a flow [m^3/s]; ``gains(side, drop_a, drop_b, p,
  plant)``, the flows into A and B per opening [m^2/s], for an opening with the sign ``side`` and pressure drops between A or B
  and the port that it is connected with [Pa]; and ``drop_ratio(side, speed_a, speed_b, p)``, the pressure drops of both up to
  a common factor, where A takes in a flow that is proportional to ``speed_a``, and B gives off ``speed_b``;

and

* ``event(opening, mode, p)``, an event function, which turns positive when a mode must change; each mode is 1 or -1;
* ``switch(opening, mode, p)``, which changes the modes at the event.

``opening`` is the spool displacement effective at the edges [m]; a positive one connects P with A.
"""

from typing import Any, Protocol

from ehls_ros.arrays import Array


class Valve(Protocol):
    """The attributes of a valve's file; ``load_flow``, all flows are optional."""

    EQUATION: str
    SOURCE: str
    Parameters: Any
    MODES: int

    def check(self, p: Any, where: str) -> None:
        """Raise BadInput if keys contradict each other."""

    def event(self, opening: float, mode: Array, p: Any) -> float:
        """Return an event function, which turns positive when a mode must change."""

    def switch(self, opening: float, mode: Array, p: Any) -> None:
        """Change the modes at the event."""
