"""What an effect's file provides.

Always: ``STAGE``, ``EQUATION``, ``SOURCE`` and ``Parameters``, a named tuple whose defaults are the
neutral values, those that change nothing. Then at least one of

* ``shift(rig, parameters) -> rig``, when the effect is another value of the rig's own parameters;
* compiled hooks ``name(value, t, y, w, z, p) -> value``, when the equations change. ``value`` is what the
  model has so far, the effects before it in the list included; what comes back takes its place.

==================  =====================================================================
hook                value
==================  =====================================================================
``command``         spool command reaching the valve [m]
``opening``         spool displacement the orifice sees [m]
``supply_pressure`` supply pressure at the valve [Pa]
``bulk_modulus``    effective bulk modulus [Pa]
``leakage``         leakage flow beyond Ctc pL [m^3/s]
``friction_level``  Stribeck level s(v) [N]
``force``           force on the mass along +x beyond (3) [N]
==================  =====================================================================

Arguments: ``t`` time [s]; ``y`` the plant's state, ``w`` its inputs (indices in
:mod:`ehls_ros.physics.plant`); ``z`` the effect's own states; ``p`` its parameters as a float array in
their order. An effect with own states says how many in ``STATES`` and has a compiled
``derivatives(t, y, w, z, p, dz)``; they start at zero.
"""

from typing import Any, Literal, Protocol

HOOKS = ("command", "opening", "supply_pressure", "bulk_modulus", "leakage", "friction_level", "force")
"""The places in the model where an effect can act."""

Stage = Literal["valve", "flow", "friction", "mechanics", "sensors", "environment"]


class Effect(Protocol):
    """The attributes every effect's file has; ``shift``, hooks, ``STATES`` and ``derivatives`` are optional."""

    STAGE: Stage
    EQUATION: str
    SOURCE: str
    Parameters: Any
