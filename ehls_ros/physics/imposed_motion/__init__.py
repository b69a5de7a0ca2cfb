"""Run the model along a recording: measured states are imposed, and only unmeasured ones are integrated.

A part is one relation of the model with all effects that act in it behind flags, so that another choice of effects needs no
compilation. It consists of the simulator's relations (:mod:`ehls_ros.physics.plant`), friction models and integrator. Measured
states are linear between samples.

==============  =============================================  ==========================================================
part            integrates                                     writes, one row per sample
==============  =============================================  ==========================================================
``spool``       the spool (4) from the command                 spool displacement [m]
``flow``        states of the effects on the flow              load flow [m^3/s], leakage [m^3/s], bulk modulus [Pa],
                                                               supply pressure [Pa]
``chambers``    states of the effects on the flow, and the     flow into A and into B, leakage out of A and of B [m^3/s],
                supply pressure behind its lag                 bulk modulus in A and in B, supply pressure [Pa]
``force``       states of the effects on the force             force beyond (3) [N]
``friction``    the friction model's forces (6), (8)           friction force [N]
``load``        the load's motion (3) and its friction, if an  position [m] and velocity [m/s] of the load, friction
                effect separates it from the piston            force on it [N], every other force on load and piston [N]
``readings``    states of the effects on the sensors           errors of the readings of position [m], load pressure [Pa] and
                                                               force [N]
==============  =============================================  ==========================================================
"""

from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.duals import Dual, numbers_of, parameters_of, record_rows, rows_of, value_of, values_of, width_of
from ehls_ros.physics.composition import Effects, Switched, compiled, effects_with, rig_elements
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.imposed_motion import chambers, compiled_part, flow, force, friction, load, readings, spool
from ehls_ros.physics.imposed_motion.base import ModelRun, Motion
from ehls_ros.physics.imposed_motion.chambers import Chambers
from ehls_ros.physics.imposed_motion.friction import FrictionInputs
from ehls_ros.physics.imposed_motion.load import Piston
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import EffectiveRig, EffectUse
from ehls_ros.physics.valve import VALVES


class Part(NamedTuple):
    """One relation of the model along a recording.

    Attributes:
        hooks: the hooks that act in it.
        module: module with the builder.
        columns: number of values it writes per sample.
        coefficients: names of the plant's coefficients that it reads, with the project's own effects.
        at_once: most parameters that one run of duals differentiates by; more are divided among several runs.
        has_friction: whether it contains a friction model.
        has_chambers: whether it contains a cylinder with two chambers, and its valve.
    """

    hooks: tuple[str, ...]
    module: ModuleType
    columns: int
    coefficients: tuple[str, ...] = Plant._fields
    at_once: int = 7
    has_friction: bool = False
    has_chambers: bool = False

    @property
    def effects(self) -> Effects:
        """The effects that act in it."""
        return effects_with(*self.hooks)

    @property
    def width(self) -> int:
        """Floats in a dual of it; only a friction model has events."""
        return width_of(self.at_once, events=self.has_friction)


_OIL = (
    "supply_pressure", "oil_density", "bulk_modulus", "discharge_coefficient", "valve_area_gradient", "leakage_coefficient",
)  # fmt: skip

PARTS = {
    "spool": Part(("received", "command"), spool, 1, ("valve_bandwidth", "valve_gain")),
    "flow": Part(("opening", "supply_pressure", "bulk_modulus", "leakage"), flow, 4, _OIL),
    "chambers": Part(("opening", "piston_leakage"), chambers, 7, _OIL, has_chambers=True),
    "force": Part(("force",), force, 1, ("moving_mass", "piston_area", "spring_stiffness", "gravity")),
    "friction": Part(("friction_level",), friction, 1, (), 14, has_friction=True),
    "load": Part(("friction_level", "force"), load, 4, at_once=14, has_friction=True),
    "readings": Part(("position_reading", "pressure_reading", "force_reading"), readings, 3, ()),
}
"""The parts by name."""

_OWN = frozenset(EFFECTS.own_names())


def effects_in(name: str, rig: EffectiveRig) -> tuple[EffectUse, ...]:
    """Return the effects of a rig that act in a part."""
    among = PARTS[name].effects.names
    return tuple(use for use in rig.effects if use.name in among)


def coefficients_read(name: str, rig: EffectiveRig) -> tuple[str, ...]:
    """Return the names of the plant's coefficients that a part of a rig reads; an effect of others may read any."""
    own = all(use.name in _OWN for use in effects_in(name, rig))
    return PARTS[name].coefficients if own else Plant._fields


def parts_along(rig: EffectiveRig) -> tuple[str, ...]:
    """Return the names of the parts that a rig's cylinder has."""
    absent = "flow" if rig.cylinder.law.CHAMBERS else "chambers"
    return tuple(name for name in PARTS if name != absent)


VARIED = ("position", "velocity", "pressure", "spool")
"""Signals of a motion that may be duals."""

Inputs = FrictionInputs | Piston | Chambers | None
"""Inputs of a part besides the recording."""


def part_kernel(name: str, rig: EffectiveRig, *, duals: bool = False, moved: bool = False) -> ModuleType:
    """Return the compiled functions of a part of :data:`PARTS`, with the rig's friction model if it contains one.

    Args:
        name: the part.
        rig: the rig.
        duals: whether to compile for duals, to differentiate it.
        moved: whether the motion is a dual too.
    """
    part = PARTS[name]
    model, elements = (rig.friction_model, rig_elements(rig)) if part.has_friction else ("", 0)
    oil = (rig.cylinder.model, rig.valve.model) if part.has_chambers else ()
    return _kernel(name, model, elements, oil, duals, moved)


@cache
def _kernel(name: str, model: str, elements: int, oil: tuple[str, ...], duals: bool, moved: bool) -> ModuleType:
    part = PARTS[name]
    members: dict[str, Any] = {"part": part.module}
    numbers = {"states": part.effects.states}
    if part.has_friction:
        members["friction"], numbers["elements"] = FRICTION_MODELS.load(model), elements
    if oil:
        members["cylinder"], members["valve"] = CYLINDERS.load(oil[0]), VALVES.load(oil[1])
    if not duals:
        return compiled(compiled_part.build, {"run": "a, inputs, out"}, members, numbers, part.effects, threads=True)
    numbers |= {"width": part.width, "moved": int(moved)}
    return compiled(
        compiled_part.build_duals, {"run": "a, inputs, rows, out, found"}, members, numbers, part.effects, threads=True
    )


def run_part(name: str, rig: EffectiveRig, a: ModelRun, inputs: Inputs = None) -> Any:
    """Run a part along a recording.

    Args:
        name: the part.
        rig: the rig.
        a: the recording and the model; its coefficients, and the signals in :data:`VARIED`, may be duals.
        inputs: further inputs of the part.

    Returns:
        Values of shape (n, columns), a dual if any input varies.
    """
    part, width, read = PARTS[name], PARTS[name].width, coefficients_read(name, rig)
    # Derivatives that are zero cost as much as any other.
    without = {field: value_of(value) for field, value in a.plant._asdict().items() if field not in read}
    a = a._replace(plant=a.plant._replace(**without), friction=a.friction if part.has_friction else values_of(a.friction))
    moving = [getattr(a.motion, signal) for signal in VARIED]
    beside = () if inputs is None else inputs.varied
    varied = parameters_of([*numbers_of(a.plant), *numbers_of(a.friction), a.effects.values, *moving, *beside])
    motion = a.motion._replace(**{signal: value_of(values) for signal, values in zip(VARIED, moving, strict=True)})
    effects = Switched(a.effects.on, value_of(a.effects.values))
    alone = a._replace(motion=motion, plant=values_of(a.plant), friction=values_of(a.friction), effects=effects)
    given = None if inputs is None else inputs.values_alone
    shape = len(a.motion.time), part.columns
    if not varied:
        out = np.empty(shape)
        part_kernel(name, rig).run(alone, given, out)
        return out
    moved = bool(parameters_of(moving))
    values, tangents = np.empty(0), dict[int, Array]()
    for first in range(0, len(varied), part.at_once):
        group, out = varied[first : first + part.at_once], np.empty((*shape, width))
        found = np.empty((1 + len(group), *reversed(shape)))
        rows = compiled_part.Rows(
            record_rows(a.plant, width, group),
            record_rows(a.friction, width, group),
            rows_of(a.effects.values, width, group),
            tuple(rows_of(signal, width, group) for signal in beside),
            np.stack([rows_of(s, width, group) for s in moving]) if moved else np.empty((0, 0, 0)),
        )
        part_kernel(name, rig, duals=True, moved=moved).run(alone, given, rows, out, found)
        values = found[0].T
        tangents |= {parameter: tangent.T for parameter, tangent in zip(group, found[1:], strict=True)}
    return Dual(values, tangents)


def compile_part(name: str, rig: EffectiveRig, *, duals: bool = False) -> None:
    """Compile or load a part by compiled_part it along two samples at standstill.

    Args:
        name: the part.
        rig: the rig.
        duals: whether to compile for duals, with a constant motion.
    """
    part, rest = PARTS[name], np.zeros(2)
    none = part.effects.parameters(())
    varied = Dual(none.values, {0: np.zeros(len(none.values))}) if duals else none.values
    motion = Motion(np.array([0.0, 1.0]), *(rest for _ in Motion._fields[1:]))
    a = ModelRun(motion, np.array([True, False]), 1.0, 0, 0, rig.plant, rig.friction, none._replace(values=varied))
    inputs: dict[str, Inputs] = {
        "friction": FrictionInputs(rest, rest, 1.0),
        "load": Piston(none, 0, 1.0, 1.0),
        "chambers": Chambers(rest, rest, rest, False, rig.cylinder.parameters, rig.valve.parameters),
    }
    run_part(name, rig, a, inputs.get(name))
