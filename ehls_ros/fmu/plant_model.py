"""The rig as a model for an FMU."""

from collections.abc import Iterator, Sequence

from ehls_ros.fmu import plant_slopes
from ehls_ros.fmu.machine_code import is_compilable
from ehls_ros.fmu.model import Block, Causality, Model, Variable, constant, parameters_of
from ehls_ros.fmu.plant_kernel import INPUT_COUNT, build
from ehls_ros.fmu.unit_definitions import SIGNAL_UNITS
from ehls_ros.physics.composition import compiled, effects_in_kernel
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.plant import FRICTION, INPUTS
from ehls_ros.physics.rig import EffectiveRig, Rig
from ehls_ros.physics.simulator import OIL_TEMPERATURE, at_rest
from ehls_ros.schema import fields_of

STATES = (
    ("position", "m", "position of the moving mass"),
    ("velocity", "m/s", "velocity of the moving mass"),
    ("load_pressure", "Pa", "load pressure"),
    ("spool_position", "m", "spool displacement"),
)
"""Name, unit and meaning of the first states."""

RATE_UNITS = ("m/s", "m/s^2", "Pa/s", "m/s")

HIGHEST = 1e30
"""Bound of inputs that are only required to be finite."""


def plant_model(rig: Rig, name: str, period: float = 1e-3, step: float | None = None) -> Model:
    """Return the model of a rig.

    Args:
        rig: the rig.
        name: name of the model.
        period: sample period of command and sensors [s].
        step: largest integration step [s], see :func:`~ehls_ros.physics.integration_step.steps_per_period`.
    """
    simulated = at_rest(rig, period, step)
    constants, state, parts = simulated.constants, simulated.state, simulated.parts
    columns, earlier = state.sensors.past.shape[1], state.inputs.size - INPUTS
    block = Block()
    block.add(_clock(constants.period, constants.step, constants.steps))
    shifted = _shifted(rig)
    at = {
        "plant": block.add(parameters_of("plant", constants.plant, shifted)),
        "friction": block.add(parameters_of("friction", constants.friction, shifted)),
        "cylinder": block.add(parameters_of("cylinder", constants.cylinder)),
        "valve": block.add(parameters_of("valve", constants.valve)),
        "effects": block.add(_effects(simulated.rig)),
        "table": block.add(_sensors(simulated.rig, state.sensors.table.tolist())),
        "position": block.add([_initial_position(rig)]),
        "oil": block.add(_initial_oil(simulated.rig)),
        "inputs": block.add(_inputs()),
        "noise": block.add(_noise(rig.sensed)),
        "measured": block.add(_signals(rig.sensed, "", "output", "reading: ")),
        "truth": block.add(_signals(rig.sensed, "true.", "local", "true value: ")),
    }
    # A command in transit is no input of a differential equation.
    exchange = earlier == 0
    names = [*_states(simulated.rig, parts.numbers["elements"], parts.numbers["states"])]
    first_rate = len(block.variables) + len(names)
    at["state"] = block.add(
        Variable(f"state.{key}", "local", "continuous", unit, text, rate=first_rate + i if exchange else None)
        for i, (key, unit, _, text) in enumerate(names)
    )
    at["rates"] = block.add(
        Variable(f"der(state.{key})", "local", "continuous", unit, f"rate of the {text}") for key, _, unit, text in names
    )
    at["event"] = block.add(
        [Variable("event", "local", "continuous", "", "event indicator, positive where a mode must change")]
    )
    at["mode"] = block.add(_modes(simulated.rig, parts.numbers["elements"]))
    at["held"] = block.remember(state.inputs)
    at["lagged"] = block.remember(state.sensors.lagged)
    at["past"] = block.remember(state.sensors.past.ravel())
    at["work"] = block.reserve(state.work.size)
    places = {f"{name}_at": index for name, index in at.items()}
    numbers = {**parts.numbers, "weights": len(constants.effects), "earlier": earlier, "columns": columns}
    numbers["signals"] = len(rig.sensed)
    names_of = ("start", "step", "rates", "change")
    kernel = compiled(build, dict.fromkeys(names_of, "block"), parts.members, {**numbers, **places}, parts.effects)
    entries = dict.fromkeys(names_of if exchange else names_of[:2], kernel)
    seed = slope = 0
    if exchange:
        seed, slope = block.reserve(len(block.variables)), block.reserve(len(block.variables))
        coefficients = at["effects"] - at["plant"]
        duals = block.reserve(plant_slopes.scratch_size(state.y.size, coefficients, len(constants.effects), len(rig.sensed)))
        own = {
            **parts.numbers,
            "signals": len(rig.sensed),
            "weights": len(constants.effects),
            "seed_at": seed,
            "slope_at": slope,
            "duals_at": duals,
        }
        derived = compiled(plant_slopes.build, {"slopes": "block"}, parts.members, {**own, **places}, parts.effects)
        if is_compilable(derived, "slopes"):
            entries["slopes"] = derived
    return Model(
        name,
        f"Electro-hydraulic load simulator: {rig.friction_model} friction, {_listed(rig)}",
        block,
        entries,
        at["event"] if exchange else None,
        period,
        {
            "valve": ["valve_command"],
            "sensors": list(rig.sensed),
            "actuator": [variable.name for variable in block.variables if variable.name.startswith("disturbance_")],
        },
        seed,
        slope,
    )


def _listed(rig: Rig) -> str:
    names = [use.name for use in rig.effects]
    return f"effects {', '.join(names)}" if names else "no effects"


def _shifted(rig: Rig) -> str:
    """Return the remark on coefficients that effects have shifted; empty if no effect shifts any."""
    names = [use.name for use in rig.effects if hasattr(EFFECTS.load(use.name), "shift")]
    return f"; includes {', '.join(names)}" if names else ""


def _clock(period: float, step: float, steps: int) -> Iterator[Variable]:
    yield Variable("time", "independent", "continuous", "s", "time")
    yield Variable("cycle", "local", "discrete", "1", "number of completed sample periods")
    yield constant("sample_period", "s", period, "sample period of command and sensors")
    yield constant("integration_step", "s", step, "integration step")
    yield constant("integration_steps", "1", steps, "integration steps per sample period")


def _effects(rig: EffectiveRig) -> Iterator[Variable]:
    counts = dict[str, int]()
    for use in effects_in_kernel(rig):
        counts[use.name] = counts.get(use.name, 0) + 1
        index = f"[{counts[use.name]}]" if counts[use.name] > 1 else ""
        yield from parameters_of(f"effects.{use.name}{index}", use.parameters)


def _sensors(rig: EffectiveRig, table: list[list[float]]) -> Iterator[Variable]:
    described = fields_of(Sensor)
    for signal, row in zip(rig.sensed, table, strict=True):
        smoothing, delay, *values = row
        yield constant(f"sensors.{signal}.smoothing", "1", smoothing, "share of a change that the lag passes in a sample")
        yield constant(f"sensors.{signal}.delay", "1", delay, "delay in sample periods")
        for key, value in zip(("gain", "bias", "noise_std", "resolution"), values, strict=True):
            note = described[key].note
            low = 0.0 if note.minimum is None and note.above is None else note.minimum if note.minimum is not None else -HIGHEST
            yield Variable(
                f"sensors.{signal}.{key}",
                "parameter",
                "tunable",
                SIGNAL_UNITS[signal] if note.unit == "signal" else note.unit,
                note.description,
                value,
                -HIGHEST if key == "bias" else low,
                HIGHEST,
                note.above,
            )


def _initial_position(rig: Rig) -> Variable:
    low, high = rig.limits.position
    return Variable("initial_position", "parameter", "fixed", "m", "position of the piston at the start", 0.0, low, high)


def _initial_oil(rig: EffectiveRig) -> Iterator[Variable]:
    for number, value in enumerate(rig.cylinder.law.at_rest(rig.cylinder.parameters, rig.plant)):
        text = f"state {number + 1} of the {rig.cylinder.model} cylinder at the start"
        yield Variable(f"initial_oil[{number + 1}]", "parameter", "fixed", "Pa", text, value, -HIGHEST, HIGHEST)


def _inputs() -> list[Variable]:
    rows = (
        ("valve_command", "m", "spool command, held over a sample period", 0.0),
        ("disturbance_force", "N", "force of the actuator under test along +x at the start of a period", 0.0),
        ("disturbance_force_rate", "N/s", "rate of that force within the period", 0.0),
        ("disturbance_displacement", "m", "displacement of the actuator under test at the start of a period", 0.0),
        ("disturbance_velocity", "m/s", "velocity of the actuator under test", 0.0),
        ("oil_temperature_supplied", "K", "oil temperature at the start of a period", OIL_TEMPERATURE),
        ("oil_temperature_rate", "K/s", "rate of the oil temperature", 0.0),
    )
    if len(rows) != INPUT_COUNT:
        raise AssertionError(f"{len(rows)} inputs")
    return [Variable(name, "input", "continuous", unit, text, start, -HIGHEST, HIGHEST) for name, unit, text, start in rows]


def _noise(signals: Sequence[str]) -> Iterator[Variable]:
    for signal in signals:
        text = f"standard normal number for the next reading of {signal.replace('_', ' ')}; 0: no noise"
        yield Variable(f"noise.{signal}", "input", "discrete", "1", text, 0.0, -HIGHEST, HIGHEST)


def _signals(signals: Sequence[str], prefix: str, causality: Causality, meaning: str) -> Iterator[Variable]:
    for signal in signals:
        yield Variable(f"{prefix}{signal}", causality, "continuous", SIGNAL_UNITS[signal], meaning + signal.replace("_", " "))


def _states(rig: EffectiveRig, elements: int, states: int) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, unit, unit of the rate and meaning of each state."""
    if len(STATES) != FRICTION:
        raise AssertionError(f"{len(STATES)} states")
    for (key, unit, text), rate in zip(STATES, RATE_UNITS, strict=True):
        yield key, unit, rate, text
    for element in range(elements):
        yield f"friction_force[{element + 1}]", "N", "N/s", f"friction force {element + 1}"
    for state in range(rig.cylinder.law.STATES):
        yield f"oil[{state + 1}]", "Pa", "Pa/s", f"state {state + 1} of the {rig.cylinder.model} cylinder"
    number = 0
    for use in effects_in_kernel(rig):
        for own in range(getattr(EFFECTS.load(use.name), "STATES", 0)):
            number += 1
            yield f"effects[{number}]", "", "", f"state {own + 1} of {use.name}"
    if number != states:
        raise AssertionError(f"{number} states of effects")


def _modes(rig: EffectiveRig, elements: int) -> Iterator[Variable]:
    for number in range(rig.valve.law.MODES):
        yield Variable(f"mode.valve[{number + 1}]", "local", "discrete", "1", "1 or -1: side of the valve opening")
    for number in range(rig.cylinder.law.MODES):
        yield Variable(f"mode.cylinder[{number + 1}]", "local", "discrete", "1", "1: full of oil; -1: with a cavity")
    for element in range(elements):
        yield Variable(f"mode.friction[{element + 1}]", "local", "discrete", "1", "0: sticks; 1 or -1: slips in that direction")
