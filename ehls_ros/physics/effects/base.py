"""Interface of the file of an effect.

Required are ``GROUP``, ``EQUATION``, ``SOURCE`` and ``WORDS``; ``Parameters``, a named tuple with neutral defaults, for which
the effect changes nothing; and ``forms(rig) -> tuple[Form, ...]``, the ways to fit the effect to data. Also at least one of

* ``shift(rig, parameters) -> rig``, if the effect changes the rig's parameters; if these are coefficients of the friction
  model, ``SHIFTS`` names them, and a rig whose model has none of them is rejected;
* compiled hooks ``name(value, t, y, w, z, p, plant) -> value``, if it changes the equations. ``value`` is that of the model
  and of the effects earlier in the list; the returned value replaces it.

====================  =====================================================================
hook                  value
====================  =====================================================================
``received``          last spool command that has arrived at the valve [m]
``command``           command that the spool follows [m]
``opening``           spool displacement effective at the orifice [m]
``supply_pressure``   supply pressure at the valve [Pa]
``bulk_modulus``      effective bulk modulus [Pa]
``leakage``           leakage flow beyond Ctc pL [m^3/s]
``friction_level``    Stribeck level s(v) [N]
``force``             force on the moving mass along +x beyond (3) [N]
``piston_position``   position of the piston, if it differs from the mass's [m]
``piston_velocity``   velocity of the piston, if it differs from the mass's [m/s]
``position_reading``  position that its sensor senses [m]
``pressure_reading``  load pressure that its sensors sense [Pa]
``force_reading``     force that the load cell senses [N]
====================  =====================================================================

Where the pressures of both chambers are states, as in a single rod, the hooks ``supply_pressure``, ``bulk_modulus`` and
``leakage`` are not called. An effect that has one of them acts on such a cylinder by ``shift_chambers(rig, parameters)``, which
returns the rig with other parameters in addition to ``shift``, or by a hook on a chamber, or is refused:

==================  ===========================================================================================
hook                value, and the argument after it
==================  ===========================================================================================
``piston_leakage``  leakage from chamber A to B past the piston [m^3/s]; the difference of their pressures [Pa]
==================  ===========================================================================================

``NOT_IN_CHAMBERS`` names those of its parameters that have no meaning there, ``ONLY_IN_CHAMBERS`` those that have none in a
cylinder with one pressure; they must be neutral. An effect with ``shift_chambers`` and neither ``shift`` nor hooks acts in
chambers only. ``SIDES`` gives the side on which a parameter acts, ``a``, ``b`` or ``both``. ``FIXED`` names the parameters that
no form fits; a report tells the size of an effect with one other parameter in words.

Arguments: ``t`` time [s]; ``y`` the plant's state and ``w`` its inputs (indices in :mod:`ehls_ros.physics.plant`); ``z`` the
effect's own states; ``p`` its ``Parameters``; ``plant`` the effective rig's :class:`~ehls_ros.physics.parameters.Plant`. A
hook depends only on its arguments and changes none of them. A diagnosis compiles the hooks of all effects together, so a
hook must be cheap, and finite at the neutral values.

The value returned by a ``reading`` hook differs from the given one by the sensor's error, which does not depend on it.

An effect with states gives their number in ``STATES`` and has a compiled ``derivatives(u, t, y, w, z, p, plant, dz)``; ``u``
is the command [m] after ``received`` and the ``command`` hooks of earlier effects. The states start at zero. An effect that
needs its states only for some parameters has ``longest_step(parameters)``, which returns the longest integration step along a
recording [s], infinite where nothing is to be integrated.

The value of ``received`` is constant between jumps; the hook is called at the start of a cycle and after each jump. An effect
with this hook gives its longest delay in ``REACH`` [s] and that of its parameters by ``reach(parameters)``, and has a compiled
``jump(t, w, p)``, which returns the time of the next jump after t [s], or infinity.

:mod:`ehls_ros.physics.sensitivity` differentiates hooks and shifts. The hooks of an effect may jump where no event is located,
so that the trajectory has no derivatives. Such an effect has ``corner(parameters, period, varied)``, which returns the reason,
or an empty text for parameters without such jumps. ``varied`` is whether the effect's parameters vary.

An effect may separate the load from the piston by play or elasticity. Position and velocity of the state then belong to the
load, on which all terms of (3) act except the pressure. Those of the piston are states of the effect; volume balance and
sensors use them. Such an effect has both ``piston`` hooks, and its ``force`` replaces the pressure force by the joint's.
``PISTON`` is the index of its state for the displacement of the piston relative to the load; the next state is the piston's
velocity. ``piston_share(parameters)`` returns the piston's fraction of the moving mass, or zero if the parameters do not
separate them, and ``shift`` removes it from the moving mass. A rig has at most one such effect.

An effect that lets a mass yield names in ``YIELDING`` the parameters that tell how far. As long as the data determine none of
them, the mass may as well be rigid: its simulated motion is only smoother than the measured one.

An effect whose ``force`` acts between loader and position servo has ``COUPLES = True``: where the servo is simulated
(:mod:`ehls_ros.physics.servo`), the same force acts on it in the opposite direction.

An effect whose shape is found in the data, such as a table, has ``LEARNT = True`` and no forms
(:mod:`ehls_ros.diagnosis.empirical`).

``NEEDS`` names the signals (:data:`ehls_ros.trajectory.SIGNALS`) without which data cannot reveal the effect; by default,
those of its group.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

if TYPE_CHECKING:
    from ehls_ros.physics.rig import Rig

MEMORY_STEP = 2.5e-4
"""Longest integration step of an effect's own states and of a separate load along a recording [s].

Origin: at twice that, the plays of a hysteresis lag as if by a command delay of 0.13 ms.
"""

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
    "position_reading",
    "pressure_reading",
    "force_reading",
)
"""The points in the model where an effect can act."""

CHAMBER_HOOKS = ("piston_leakage",)
"""Those of a cylinder whose chambers' pressures are states; a pressure is their second argument."""

LOAD_PRESSURE_HOOKS = ("supply_pressure", "bulk_modulus", "leakage")
"""Those that such a cylinder does not have."""

Side = Literal["a", "b", "both"]
"""Chamber of a cylinder: A pushes towards +x, B towards -x."""

Group = Literal["valve", "flow", "friction", "mechanics", "sensors", "environment"]
"""Part of the rig that an effect changes; a heading in lists of effects."""


class Words(NamedTuple):
    """Wording of an effect in reports. The advice applies if the effect is the cause: one imperative sentence each.

    Attributes:
        noun: the effect within a sentence, with its article: "The simulation lacks <noun>".
        inspect: part of the rig to inspect.
        measure: quick measurement that would confirm it.
        change: change to the rig file, or to the rig so that its file remains valid.
        lacking: whether the model lacks the term; if False, it has the term with a wrong value ("has <noun> wrong").
    """

    noun: str
    inspect: str
    measure: str
    change: str
    lacking: bool = True


class Share(NamedTuple):
    """Fraction of a signal's largest magnitude in the data."""

    signal: str
    fraction: float


class Quantile(NamedTuple):
    """Quantile of a signal in the data."""

    signal: str
    fraction: float


class Peak(NamedTuple):
    """Frequency of a spectral line of the residual, the strongest being rank 1 [Hz]."""

    rank: int


class Period(NamedTuple):
    """Period of the wave along a signal that predicts the residual best, in the signal's unit; no start if none predicts it.

    Attributes:
        signal: the signal along which the residual repeats.
        turning: whether the sign of the wave follows the direction of motion.
    """

    signal: str
    turning: bool = False


Start = float | Share | Quantile | Peak | Period
"""Starting value of a parameter's fit: a number, or derived from the data; signals as in ``NEEDS``."""


class Form(NamedTuple):
    """One way to fit an effect to data; parameters not listed stay neutral.

    Attributes:
        free: starting values of each fitted parameter. The first values of all parameters are one start, the second values
            the next, and so on, so all tuples have the same length. An empty tuple is for a parameter that acts smoothly,
            such as linearly: it starts at its neutral value.
        fixed: values of parameters that are neither neutral nor fitted.
    """

    free: Mapping[str, tuple[Start, ...]]
    fixed: Mapping[str, float] = {}


class Effect(Protocol):
    """The attributes that every effect's file has; the others listed above are optional."""

    GROUP: Group
    EQUATION: str
    SOURCE: str
    WORDS: Words
    Parameters: Any

    def forms(self, rig: "Rig") -> tuple[Form, ...]:
        """Return the ways to fit the effect to a rig's data, each with a free parameter; none if the effect cannot act."""


def acts_on_chambers(effect: Any) -> bool:
    """Return whether an effect can act on a cylinder whose chambers' pressures are states."""
    own = any(hasattr(effect, hook) for hook in (*CHAMBER_HOOKS, "shift_chambers"))
    return own or not any(hasattr(effect, hook) for hook in LOAD_PRESSURE_HOOKS)


def acts_on_one_pressure(effect: Any) -> bool:
    """Return whether an effect can act on a cylinder with one pressure."""
    return any(hasattr(effect, name) for name in (*HOOKS, "shift"))


def side_of(effect: Any, parameters: Any) -> Side | None:
    """Return the side on which an effect acts with some parameters; None for an effect that has none."""
    neutral = type(parameters)()
    sides = getattr(effect, "SIDES", {})
    found = {
        sides[name]
        for name, value, none in zip(neutral._fields, parameters, neutral, strict=True)
        if name in sides and value != none
    }
    if not found:
        return None
    return found.pop() if len(found) == 1 else "both"
