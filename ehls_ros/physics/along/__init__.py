"""The model run along a recording: what was measured is imposed, and only what was not is integrated.

A part is one relation of the model, with all effects of the family that act in it behind flags, so that trying another
choice of effects costs no compilation. It is made of the simulator's own relations (:mod:`ehls_ros.physics.plant`),
friction models and integrator. The measured states go straight from one sample to the next.

==============  =============================================  ==========================================================
part            integrates                                     writes, a row a sample
==============  =============================================  ==========================================================
``spool``       the spool (4) from the command                 spool displacement [m]
``flow``        what the effects on the flow remember          load flow [m^3/s], leakage [m^3/s], bulk modulus [Pa],
                                                               supply pressure [Pa]
``force``       what the effects on the force remember         force beyond (3) [N]
``friction``    the friction model's forces (6), (8)           friction force [N]
``load``        the load's motion (3) and its friction, where  position [m] and velocity [m/s] of the load, friction
                an effect parts it from the piston             force on it [N], every other force on load and piston [N]
==============  =============================================  ==========================================================
"""

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.physics.along import flow, force, friction, load, spool
from ehls_ros.physics.along.base import Along, Motion
from ehls_ros.physics.along.friction import Begun
from ehls_ros.physics.along.load import Piston
from ehls_ros.physics.composition import Effects, compiled, effects_with, rig_elements
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.rig import EffectiveRig


class Part(NamedTuple):
    """One relation of the model along a recording.

    Attributes:
        hooks: those that act in it.
        build: what builds its compiled functions.
        entries: these, with their arguments.
        columns: how many values it writes a sample.
        rubs: whether it runs a friction model.
    """

    hooks: tuple[str, ...]
    build: Callable[..., Any]
    entries: dict[str, str]
    columns: int
    rubs: bool = False

    @property
    def effects(self) -> Effects:
        """The effects that act in it."""
        return effects_with(*self.hooks)


_RUN = {"run": "a, out"}

PARTS = {
    "spool": Part(("received", "command"), spool.build, _RUN, 1),
    "flow": Part(("opening", "supply_pressure", "bulk_modulus", "leakage"), flow.build, _RUN, 4),
    "force": Part(("force",), force.build, _RUN, 1),
    "friction": Part(("friction_level",), friction.build, {"run": "a, begun, out"}, 1, rubs=True),
    "load": Part(("friction_level", "force"), load.build, {"run": "a, piston, out"}, 4, rubs=True),
}
"""The parts by name."""


def part_kernel(name: str, rig: EffectiveRig) -> ModuleType:
    """Return the compiled functions of a part of :data:`PARTS`, with the rig's friction model where it runs one."""
    return _kernel(name, rig.friction_model, rig_elements(rig)) if PARTS[name].rubs else _kernel(name, "", 0)


@cache
def _kernel(name: str, model: str, elements: int) -> ModuleType:
    part = PARTS[name]
    numbers = {"states": part.effects.states}
    if not part.rubs:
        return compiled(part.build, part.entries, numbers=numbers, effects=part.effects, threads=True)
    members, numbers = {"friction": FRICTION_MODELS.load(model)}, {"elements": elements, **numbers}
    return compiled(part.build, part.entries, members, numbers, part.effects, threads=True)


def compile_part(name: str, rig: EffectiveRig) -> None:
    """Compile a part, or load it: run it along two samples at rest."""
    part, rest = PARTS[name], np.zeros(2)
    none = part.effects.parameters(())
    motion = Motion(np.array([0.0, 1.0]), *(rest for _ in Motion._fields[1:]))
    a = Along(motion, np.array([True, False]), 1.0, 0, 0, rig.plant, rig.friction, none)
    beside = {"friction": (Begun(rest, rest, 1.0),), "load": (Piston(none, 0, 1.0, 1.0),)}
    part_kernel(name, rig).run(a, *beside.get(name, ()), np.empty((2, part.columns)))
