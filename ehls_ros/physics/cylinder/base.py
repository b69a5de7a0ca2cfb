"""Interface of the file of a cylinder.

A cylinder turns the valve's flows and the piston's motion into rates of the oil's states. The force balance reads one pressure,
``y[PL]`` of :mod:`ehls_ros.physics.plant`: the driving force over ``plant.piston_area``.

A file has

* ``EQUATION``, ``SOURCE`` and ``Parameters``, a named tuple that declares the keys of the rig file's ``cylinder`` section;
* ``STATES``, the number of its states, which follow the friction forces in ``y``, and ``MODES``, the number of its modes,
  which follow those of the valve;
* ``SENSED``, the signals it has beyond those of every rig;
* ``FLOW``, the function of a valve that it uses, and ``DEFAULT_VALVE``, the valve of a rig file without the section ``valve``;
* ``CHAMBERS``, whether the pressures of both chambers are states. Then the effects on the oil act by their hooks on a chamber
  (:mod:`ehls_ros.physics.effects.base`) instead of those on the load pressure.

These functions are called from Python before a run:

* ``check(p, where)`` raises :class:`~ehls_ros.errors.BadInput` if keys contradict each other;
* ``check_stroke(p, ends, where)`` raises it if the cylinder cannot move between the bounds of the position, ``ends`` [m];
* ``derived(p)`` returns the keys of ``plant`` that follow from those of the cylinder, and are left out of the rig file;
* ``at_rest(p, plant)`` returns the states of a rig at rest without driving force;
* ``forces(p, plant)`` returns the lowest and the highest driving force that the supply can hold [N];
* ``oil_rates(rig, flow)`` returns the largest natural rates of the oil, see :class:`OilRates`;
* ``equivalent(valve)`` returns a compiled ``equivalent(m, spool, least, plant, p, v)``: the
  :class:`Equivalent` with the same rate of the driving force at the readings ``m`` (NaN: unknown; those of the chambers may be
  left out) on the side of null of ``spool``; pressure drops are at least ``least`` of the supply pressure, and ``v`` are the
  parameters of the valve;
* ``load_flow(valve)`` returns, with the same arguments, the compiled flow QL of that double rod at the spool displacement,
  overlaps and roundings included [m^3/s]; NaN if a pressure drop is less than ``least`` of the supply pressure;
* ``terms(valve, chains)``, only with ``CHAMBERS``, returns the compiled terms of the chambers' balances, see
  :class:`ehls_ros.physics.cylinder.two_chamber.Terms`;
* ``build(valve, chains, first)`` returns the compiled functions of the oil, see :class:`~ehls_ros.physics.plant.Oil`;
  ``first`` is the index of its first state in ``y``.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ehls_ros.physics.parameters import Plant

if TYPE_CHECKING:
    from ehls_ros.physics.plant import Chains, Oil
    from ehls_ros.physics.rig import EffectiveRig


class OilRates(NamedTuple):
    """Largest natural rates of the oil in a cylinder, for the choice of an integration step.

    Attributes:
        column: stiffness of the oil column on the piston [N/m].
        leakage: rate at which leakages equalise the pressures [1/s].
        orifice: rate at which the valve's flow does [1/s].
        keys: keys of ``plant`` that they depend on.
    """

    column: float
    leakage: float
    orifice: float
    keys: tuple[str, ...]


class Equivalent(NamedTuple):
    """Double rod that stands for a cylinder of two chambers.

    Attributes:
        plant: its coefficients.
        supply_pressure: its supply pressure [Pa].
        offset: constant force by which its driving force is smaller [N].
        stiffness: stiffness of the oil at the present position, over that at position 0 [1].
    """

    plant: Plant
    supply_pressure: float
    offset: float
    stiffness: float


class Cylinder(Protocol):
    """The attributes of a cylinder's file."""

    EQUATION: str
    SOURCE: str
    Parameters: Any
    STATES: int
    MODES: int
    SENSED: tuple[str, ...]
    FLOW: str
    DEFAULT_VALVE: str
    CHAMBERS: bool

    def check(self, p: Any, where: str) -> None:
        """Raise BadInput if keys contradict each other."""

    def check_stroke(self, p: Any, ends: tuple[float, float], where: str) -> None:
        """Raise BadInput if the cylinder cannot move between the bounds of the position [m]."""

    def derived(self, p: Any) -> dict[str, Any]:
        """Return the keys of ``plant`` that follow from those of the cylinder."""

    def at_rest(self, p: Any, plant: Any) -> tuple[float, ...]:
        """Return the states of a rig at rest without driving force."""

    def forces(self, p: Any, plant: Any) -> tuple[float, float]:
        """Return the lowest and the highest driving force that the supply can hold [N]."""

    def oil_rates(self, rig: "EffectiveRig", flow: float) -> OilRates:
        """Return the largest natural rates of the oil at a flow through the valve [m^3/s]."""

    def equivalent(self, valve: Any) -> Callable[..., Equivalent]:
        """Build the double rod that the cylinder is at the present readings, with a valve."""

    def load_flow(self, valve: Any) -> Callable[..., float]:
        """Build the flow of that double rod's valve."""

    def build(self, valve: Any, chains: "Chains", first: int) -> "Oil":
        """Return the compiled functions of the oil."""
