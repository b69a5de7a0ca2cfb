"""What an effect's file provides.

Always: ``STAGE``, ``EQUATION``, ``SOURCE``; ``Parameters``, a named tuple whose defaults are the neutral
values, those that change nothing; and ``forms(rig) -> tuple[Form, ...]``, the ways in which the effect is
fitted to data. Then at least one of

* ``shift(rig, parameters) -> rig``, when the effect is another value of the rig's own parameters; where these are
  coefficients of the friction model, ``SHIFTS`` names them, and a rig whose model has none of them is refused;
* compiled hooks ``name(value, t, y, w, z, p, plant) -> value``, when the equations change. ``value`` is what
  the model has so far, the effects before it in the list included; what comes back takes its place.

==================  =====================================================================
hook                value
==================  =====================================================================
``received``        spool command that has arrived at the valve, of those sent so far [m]
``command``         what the valve makes of it: the command the spool follows [m]
``opening``         spool displacement the orifice sees [m]
``supply_pressure`` supply pressure at the valve [Pa]
``bulk_modulus``    effective bulk modulus [Pa]
``leakage``         leakage flow beyond Ctc pL [m^3/s]
``friction_level``  Stribeck level s(v) [N]
``force``           force on the mass along +x beyond (3) [N]
``piston_position`` position of the piston, where it is not the mass's [m]
``piston_velocity`` velocity of the piston, where it is not the mass's [m/s]
==================  =====================================================================

Arguments: ``t`` time [s]; ``y`` the plant's state, ``w`` its inputs (indices in
:mod:`ehls_ros.physics.plant`); ``z`` the effect's own states; ``p`` its parameters as a float array in
their order; ``plant`` the rig's :class:`~ehls_ros.physics.parameters.Plant`, shifts worked in. A hook
depends on nothing else and changes none of them. All effects share one kernel when data are judged, so a
hook is cheap, and finite at the neutral values.

An effect with own states says how many in ``STATES`` and has a compiled
``derivatives(u, t, y, w, z, p, plant, dz)``; ``u`` is the command as it reaches the effect [m], after
``received`` and the ``command`` hooks before it. The states start at zero.

What ``received`` returns stands still but for jumps; it is asked when a cycle begins and after each jump. An
effect with this hook says how far back it looks in ``REACH`` [s], and when the next jump comes with a
compiled ``jump(t, w, p)``: the time after t [s], or infinity.

An effect that parts the load from the piston (play or elasticity between them) leaves position and velocity of the
state to the load, which everything of (3) but the pressure acts on; the piston's are states of its own, and what volume
balance and sensors see. It has both ``piston`` hooks; its ``force`` puts what the piston hands on in the pressure's
place; ``PISTON`` says which of its states is how far the piston is ahead of the load, the next being the piston's
velocity; ``piston_share(parameters)`` returns the part of the moving mass that stays with the piston, zero where these
parameters part none, and ``shift`` takes it off. A rig has at most one effect that parts them.

``NEEDS`` names the signals (:data:`ehls_ros.trajectory.SIGNALS`) without which data cannot tell the effect;
absent, it needs none beyond those of its stage.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

if TYPE_CHECKING:
    from ehls_ros.physics.rig import Rig

HOOKS = (
    "received",
    "command",
    "opening",
    "supply_pressure",
    "bulk_modulus",
    "leakage",
    "friction_level",
    "force",
    "piston_position",
    "piston_velocity",
)
"""The places in the model where an effect can act."""

Stage = Literal["valve", "flow", "friction", "mechanics", "sensors", "environment"]


class Share(NamedTuple):
    """A part of a signal's largest magnitude in the data."""

    signal: str
    part: float


class Quantile(NamedTuple):
    """The value that a part of a signal's samples in the data lies below."""

    signal: str
    part: float


class Peak(NamedTuple):
    """The frequency of the residual's strongest spectral line (rank 1), or of the next ones [Hz]."""

    rank: int


Start = float | Share | Quantile | Peak
"""Where the fit of a parameter starts, known beforehand or taken from the data; signals as in ``NEEDS``."""


class Form(NamedTuple):
    """One way to fit an effect to data; the parameters it does not name stay neutral.

    Attributes:
        free: what is fitted, each with the values its fit starts from: the first start of all together, then the
            second, and so on, so that the tuples have one length. An empty tuple: it enters smoothly (linearly, say)
            and starts at its neutral value.
        fixed: values other than neutral that stand.
    """

    free: Mapping[str, tuple[Start, ...]]
    fixed: Mapping[str, float] = {}


class Effect(Protocol):
    """The attributes every effect's file has; the others named above are optional."""

    STAGE: Stage
    EQUATION: str
    SOURCE: str
    Parameters: Any

    def forms(self, rig: "Rig") -> tuple[Form, ...]:
        """Return the ways to fit the effect to data of a rig, each with a free parameter; none where it cannot act."""
