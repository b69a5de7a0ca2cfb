"""The model run along a recording: measured states are imposed, and only what was not measured is integrated.

A part is one relation of the model with all effects that act in it behind flags, so that another choice of effects needs
no compilation. It consists of the simulator's own relations (:mod:`ehls_ros.physics.plant`), friction models and
integrator. Measured states are linear between samples.

==============  =============================================  ==========================================================
part            integrates                                     writes, one row per sample
==============  =============================================  ==========================================================
``spool``       the spool (4) from the command                 spool displacement [m]
``flow``        states of the effects on the flow              load flow [m^3/s], leakage [m^3/s], bulk modulus [Pa],
                                                               supply pressure [Pa]
``force``       states of the effects on the force             force beyond (3) [N]
``friction``    the friction model's forces (6), (8)           friction force [N]
``load``        the load's motion (3) and its friction, if an  position [m] and velocity [m/s] of the load, friction
                effect separates it from the piston            force on it [N], every other force on load and piston [N]
==============  =============================================  ==========================================================
"""

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.physics.along import flow, force, friction, load, spool
from ehls_ros.physics.along.base import ModelRun, Motion
from ehls_ros.physics.along.friction import FrictionInputs
from ehls_ros.physics.along.load import Piston
from ehls_ros.physics.composition import Effects, compiled, effects_with, rig_elements
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.rig import EffectiveRig


class Part(NamedTuple):
    """One relation of the model along a recording.

    Attributes:
        hooks: the hooks that act in it.
        build: builder of its compiled functions.
        entries: arguments of these functions, by name.
        columns: number of values it writes per sample.
        has_friction: whether it contains a friction model.
    """

    hooks: tuple[str, ...]
    build: Callable[..., Any]
    entries: dict[str, str]
    columns: int
    has_friction: bool = False

    @property
    def effects(self) -> Effects:
        """The effects that act in it."""
        return effects_with(*self.hooks)


_RUN = {"run": "a, out"}

PARTS = {
    "spool": Part(("received", "command"), spool.build, _RUN, 1),
    "flow": Part(("opening", "supply_pressure", "bulk_modulus", "leakage"), flow.build, _RUN, 4),
    "force": Part(("force",), force.build, _RUN, 1),
    "friction": Part(("friction_level",), friction.build, {"run": "a, inputs, out"}, 1, has_friction=True),
    "load": Part(("friction_level", "force"), load.build, {"run": "a, piston, out"}, 4, has_friction=True),
}
"""The parts by name."""


def part_kernel(name: str, rig: EffectiveRig) -> ModuleType:
    """Return the compiled functions of a part of :data:`PARTS`, with the rig's friction model if it contains one."""
    return _kernel(name, rig.friction_model, rig_elements(rig)) if PARTS[name].has_friction else _kernel(name, "", 0)


@cache
def _kernel(name: str, model: str, elements: int) -> ModuleType:
    part = PARTS[name]
    numbers = {"states": part.effects.states}
    if not part.has_friction:
        return compiled(part.build, part.entries, numbers=numbers, effects=part.effects, threads=True)
    members, numbers = {"friction": FRICTION_MODELS.load(model)}, {"elements": elements, **numbers}
    return compiled(part.build, part.entries, members, numbers, part.effects, threads=True)


def compile_part(name: str, rig: EffectiveRig) -> None:
    """Compile or load a part by running it along two samples at rest."""
    part, rest = PARTS[name], np.zeros(2)
    none = part.effects.parameters(())
    motion = Motion(np.array([0.0, 1.0]), *(rest for _ in Motion._fields[1:]))
    a = ModelRun(motion, np.array([True, False]), 1.0, 0, 0, rig.plant, rig.friction, none)
    inputs = {"friction": (FrictionInputs(rest, rest, 1.0),), "load": (Piston(none, 0, 1.0, 1.0),)}
    part_kernel(name, rig).run(a, *inputs.get(name, ()), np.empty((2, part.columns)))
