"""Controllers and friction observers as models for FMUs."""

from collections.abc import Iterator, Mapping
from typing import Any

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORESEEN, ROW, STATUS_SIZE, model_of
from ehls_ros.control.local_plant import memory_on
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import ELEMENTS, ObserverState
from ehls_ros.fmu.control_kernel import build_law, build_observer
from ehls_ros.fmu.model import Block, Model, Variable, constant, parameters_of
from ehls_ros.fmu.plant_model import HIGHEST
from ehls_ros.fmu.unit_definitions import SIGNAL_UNITS
from ehls_ros.physics.composition import compiled, rig_elements
from ehls_ros.physics.rig import Rig

REFERENCE_UNITS = {"force": ("N", "N/s", "N/s^2"), "position": ("m", "m/s", "m/s^2")}
"""Units of the reference and its derivatives, by what a law follows."""

STATUS = (
    ("e3", "Pa", "load pressure error e3"),
    ("s", "Pa/s", "sliding variable s"),
    ("alpha", "1", "scale of the identified friction"),
    ("beta", "1", "scale of the viscous friction"),
    ("delta", "N", "estimated remaining disturbance"),
    ("u1", "kg Pa/s^2", "adaptive term u1"),
    ("u2", "kg Pa/s^2", "model term u2"),
    ("u3", "kg Pa/s^2", "robust term u3"),
    ("force_error", "N", "force error"),
    ("force_bound", "N", "bound of the force error"),
    ("saturated", "1", "1: the command is at its limit"),
)
"""Name, unit and meaning of the quantities in a status, in SI units."""

ENTRIES = ("start", "step")


def observer_model(rig: Rig, name: str, period: float, observer: str, parameters: Any) -> Model:
    """Return the model of a friction observer.

    Args:
        rig: the rig as identified, for its friction.
        name: name of the model.
        period: sample period [s].
        observer: file name of the observer.
        parameters: its parameters.
    """
    block = _clocked(period)
    state = OBSERVERS.load(observer).state(rig.friction_law, rig.friction)
    velocity = block.add([Variable("velocity", "input", "continuous", "m/s", "measured velocity", 0.0, -HIGHEST, HIGHEST)])
    places = {"velocity": velocity, **_observer_parameters(block, rig, parameters)}
    places |= _estimate(block, state)
    places |= _observer_memory(block, state)
    places["work"] = block.reserve(state.work.size)
    numbers = {"entries": rig_elements(rig), "observed": state.forces.size, **_named(places)}
    members = {"observer": OBSERVERS.load(observer), "believed": rig.friction_law}
    kernel = compiled(build_observer, dict.fromkeys(ENTRIES, "block"), members, numbers)
    outputs = [variable.name for variable in block.variables if variable.causality == "output"]
    terminals = {"sensors": ["velocity"], "estimate": outputs}
    return Model(name, f"Friction observer {observer}", block, dict.fromkeys(ENTRIES, kernel), None, period, terminals)


def law_model(rig: Rig, name: str, period: float, law: str, tuning: Any, observer: str, parameters: Any) -> Model:
    """Return the model of a control law with its friction observer; companions are not part of it.

    Args:
        rig: the rig as described to the controller.
        name: name of the model.
        period: sample period [s].
        law: file name of the controller.
        tuning: its parameters.
        observer: file name of the observer.
        parameters: the observer's parameters.
    """
    module, own = CONTROLLERS.load(law), model_of(rig, period)
    state, memory = OBSERVERS.load(observer).state(rig.friction_law, rig.friction), memory_on(module, rig.cylinder.law, tuning)
    block = _clocked(period)
    places = _observer_parameters(block, rig, parameters)
    places["tuning"] = block.add(parameters_of("law", tuning))
    places |= {part: block.add(parameters_of(part, getattr(own, part))) for part in ("plant", "cylinder", "valve")}
    places["limit"] = block.add(_of_model(own))
    places["measured"] = block.add(
        Variable(
            signal, "input", "continuous", SIGNAL_UNITS[signal], f"reading: {signal.replace('_', ' ')}", 0.0, -HIGHEST, HIGHEST
        )
        for signal in rig.sensed
    )
    places["reference"] = block.add(_reference(module.FOLLOWS))
    places["command"] = block.add([Variable("valve_command", "output", "continuous", "m", "spool command")])
    places |= _estimate(block, state)
    status = [Variable(f"status.{key}", "local", "continuous", unit, text) for key, unit, text in STATUS]
    if len(status) != STATUS_SIZE:
        raise AssertionError(f"{len(status)} quantities in a status")
    places["status"] = block.add(status)
    places |= _observer_memory(block, state)
    places["memory"] = block.remember(memory)
    places["work"] = block.reserve(state.work.size)
    places["own"], places["row"] = block.reserve(STATUS_SIZE), block.reserve(ROW)
    numbers = {"entries": rig_elements(rig), "observed": state.forces.size, "memory": memory.size, **_named(places)}
    numbers["signals"] = len(rig.sensed)
    members = {"law": module, "cylinder": rig.cylinder.law, "valve": rig.valve.law, "observer": OBSERVERS.load(observer)}
    members["believed"] = rig.friction_law
    kernel = compiled(build_law, dict.fromkeys(ENTRIES, "block"), members, numbers)
    references = [variable.name for variable in block.variables if variable.name.startswith("reference")]
    terminals: Mapping[str, list[str]] = {"sensors": list(rig.sensed), "reference": references, "valve": ["valve_command"]}
    text = f"Controller {law} with the friction observer {observer}"
    return Model(name, text, block, dict.fromkeys(ENTRIES, kernel), None, period, terminals)


def _named(places: Mapping[str, int]) -> dict[str, int]:
    return {f"{name}_at": index for name, index in places.items()}


def _clocked(period: float) -> Block:
    block = Block()
    block.add(
        [
            Variable("time", "independent", "continuous", "s", "time"),
            Variable("cycle", "local", "discrete", "1", "number of completed sample periods"),
            constant("sample_period", "s", period, "sample period"),
        ]
    )
    return block


def _observer_parameters(block: Block, rig: Rig, parameters: Any) -> dict[str, int]:
    friction = block.add(parameters_of("friction", rig.friction))
    return {"friction": friction, "compensation": block.add(parameters_of("observer", parameters))}


def _observer_memory(block: Block, state: ObserverState) -> dict[str, int]:
    parts = {"forces": state.forces, "mode": state.mode, "last": state.last}
    return {name: block.remember(values) for name, values in parts.items()}


def _estimate(block: Block, state: ObserverState) -> dict[str, int]:
    count = (state.estimate.size - ELEMENTS) // 2
    first = block.add(
        [
            Variable("friction_force", "output", "continuous", "N", "estimated force of the friction elements"),
            Variable("viscous_force", "output", "continuous", "N", "estimated viscous friction"),
        ]
    )
    for key, unit, text in (("element_force", "N", "estimated force of element"), ("slipping", "1", "1: slips; element")):
        block.add(Variable(f"{key}[{index}]", "local", "continuous", unit, f"{text} {index}") for index in range(1, count + 1))
    return {"estimate": first}


def _of_model(own: Any) -> Iterator[Variable]:
    yield Variable("spool_limit", "parameter", "tunable", "m", "largest spool command", own.spool_limit, 0.0, above=0.0)
    for signal, value in own.noise._asdict().items():
        text = f"standard deviation of one reading of the {signal.replace('_', ' ')}"
        yield Variable(f"noise.{signal}", "parameter", "tunable", SIGNAL_UNITS[signal], text, value, 0.0)
    yield Variable("command_delay", "parameter", "fixed", "s", "delay of the command to the valve", own.command_delay, 0.0)
    for key, unit in (("coupling_stiffness", "N/m"), ("coupling_damping", "N s/m")):
        text = f"{key.partition('_')[2]} of the coupling to the actuator under test"
        yield Variable(key, "parameter", "tunable", unit, text, getattr(own, key), 0.0)


def _reference(follows: str) -> Iterator[Variable]:
    names = ("reference", "reference_rate", "reference_acceleration")
    texts = (f"{follows} to follow", "its rate", "its second derivative")
    if len(names) != FORESEEN:
        raise AssertionError(f"{len(names)} entries of a reference")
    for name, unit, text in zip(names, REFERENCE_UNITS[follows], texts, strict=True):
        yield Variable(name, "input", "continuous", unit, text, 0.0, -HIGHEST, HIGHEST)
