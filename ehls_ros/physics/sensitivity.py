"""Forward sensitivities of a simulated trajectory to the rig's coefficients, exact to rounding.

The simulator's functions are compiled for duals (:mod:`ehls_ros.duals`) instead of floats, so there is no second model: the
readings are bitwise those of :class:`~ehls_ros.physics.simulator.Simulator`, with their derivatives. Events are located, and
the effect of changes in their times is included (saltation): at break-away and reversal of friction, at sign changes of the
valve opening, at impacts, and as delayed commands arrive.

A trajectory is not differentiable where an event touches its threshold without crossing it. A coefficient at a corner of its
model, such as a play of zero, has a one-sided derivative. Corners without located events, such as those of a play, are stepped
over; the derivatives by the play's width therefore scatter by about a thousandth between steps. Readings have no derivative
through a converter of finite resolution.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba.core.errors import NumbaError

from ehls_ros.arrays import Array, kernel
from ehls_ros.duals import Dual, constant, dual_array, dual_record, record_rows, rows_of, tangents_of, value_of, width_of
from ehls_ros.errors import BadInput, one_of
from ehls_ros.physics import sensors, simulator
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.plant import FRICTION, PL, TEMPERATURE, XV, Chains, V, X, hold
from ehls_ros.physics.rig import EffectiveRig, Rig
from ehls_ros.physics.simulator import OIL_TEMPERATURE, Constants, Simulated, State, at_rest, parts_of

MAX_AT_ONCE = 22
"""Most coefficients in one run; more are divided among several. Both a run and a coefficient have a fixed cost."""

STARTS = {"start.position": X, "start.velocity": V, "start.load_pressure": PL, "start.spool": XV}
"""Initial states that can be chosen, with their indices in the state; no load pressure if a cylinder has chambers."""

WHERE = "sensitivities"


class Inputs(NamedTuple):
    """Inputs of each control cycle, shape (n,) each; all but the command may be one number for all cycles.

    Attributes:
        command: spool command, held over the cycle [m].
        force: disturbance force at the start of the cycle [N].
        force_rate: rate of the disturbance force [N/s].
        displacement: displacement of the position servo at the start of the cycle [m].
        velocity: velocity of the position servo [m/s].
        temperature: oil temperature [K].
    """

    command: Array
    force: Array | float = 0.0
    force_rate: Array | float = 0.0
    displacement: Array | float = 0.0
    velocity: Array | float = 0.0
    temperature: Array | float = OIL_TEMPERATURE


class Sensitivities(NamedTuple):
    """A trajectory and its derivatives.

    Attributes:
        readings: noise-free readings at the start of each cycle, in the order of the rig's ``sensed``, shape (n, signals).
        derivatives: derivatives of the readings by the coefficients, each in its unit, shape (n, signals, coefficients).
        dense: number of integration steps with more events than were located, normally 0; derivatives may be wrong there.
    """

    readings: Array
    derivatives: Array
    dense: int


def sensitivities(
    rig: Rig,
    coefficients: Sequence[str],
    inputs: Inputs,
    *,
    period: float = 1e-3,
    step: float | None = None,
    start: Mapping[str, float] | None = None,
) -> Sensitivities:
    """Simulate a rig from rest, with the derivatives of its readings by chosen coefficients.

    Args:
        rig: the rig; the noise of its sensors is ignored.
        coefficients: paths in the rig file: ``plant.moving_mass``, ``friction.coulomb_force``,
            ``friction.element_stiffness_1`` for the first of a list, ``effects.end_stop.upper``, ``sensors.force.gain``; or one
            of :data:`STARTS`.
        inputs: commands and disturbances.
        period: control period [s].
        step: largest integration step [s], see :func:`~ehls_ros.physics.integration_step.steps_per_period`.
        start: initial values by the names in :data:`STARTS`; by default all are 0.

    Returns:
        Readings and derivatives.

    Raises:
        BadInput: a coefficient is unknown or given twice, or a named part has no derivative.
    """
    at_once = max(1, math.ceil(len(coefficients) / MAX_AT_ONCE))
    readings, derivatives, dense = np.empty(0), list[Array](), 0
    for group in np.array_split(np.arange(len(coefficients)), at_once):
        ready = prepared(rig, [coefficients[i] for i in group], inputs, period, step, start)
        dense = ready.run()
        found = ready.readings()
        readings = found[:, :, 0].copy()
        derivatives.append(found[:, :, 1:])
    return Sensitivities(readings, np.concatenate(derivatives, axis=2), dense)


def _check(path: str, rig: Rig, start: Mapping[str, float], coefficients: Sequence[str]) -> None:
    """Reject a path that is unknown or given twice."""
    starts = [name for name, place in STARTS.items() if place != PL or not rig.cylinder.law.CHAMBERS]
    possible = (*_numbers(rig), *starts)
    if path not in possible or (path in start and path not in starts):
        raise BadInput(f"coefficient {path!r} is unknown", WHERE, one_of(path, possible))
    if list(coefficients).count(path) > 1:
        raise BadInput(f"coefficient {path!r} is given twice", WHERE, "each coefficient once")


def _numbers(rig: Rig) -> dict[str, float]:
    """Return all numbers of a rig by their paths."""
    derived = rig.cylinder.law.derived(rig.cylinder.parameters)
    oil = {"cylinder": rig.cylinder.parameters, "valve": rig.valve.parameters}
    parts: dict[str, Any] = {"plant": rig.plant, "friction": rig.friction, **{k: p for k, p in oil.items() if p}}
    parts |= {f"effects.{use.name}": use.parameters for use in rig.effects}
    parts |= {f"sensors.{signal}": rig.sensors.get(signal, Sensor()) for signal in rig.sensed}
    out = dict[str, float]()
    for section, parameters in parts.items():
        for name, value in parameters._asdict().items():
            values = {f"_{i + 1}": v for i, v in enumerate(value)} if isinstance(value, tuple) else {"": value}
            out |= {f"{section}.{name}{entry}": v for entry, v in values.items()}
    return {path: value for path, value in out.items() if path.removeprefix("plant.") not in derived}


def _varied(rig: Rig, coefficients: Sequence[str]) -> Rig:
    """Return a rig whose chosen coefficients are duals."""

    def part(section: str, parameters: Any) -> Any:
        if not parameters:
            return parameters

        def number(name: str, value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(number(f"{name}_{i + 1}", v) for i, v in enumerate(value))
            path = f"{section}.{name}"
            return Dual(value, {coefficients.index(path): 1.0}) if path in coefficients else value

        return parameters._replace(**{name: number(name, value) for name, value in parameters._asdict().items()})

    return rig._replace(
        plant=part("plant", rig.plant),
        friction=part("friction", rig.friction),
        cylinder=rig.cylinder._replace(parameters=part("cylinder", rig.cylinder.parameters)),
        valve=rig.valve._replace(parameters=part("valve", rig.valve.parameters)),
        effects=tuple(use._replace(parameters=part(f"effects.{use.name}", use.parameters)) for use in rig.effects),
        sensors={signal: part(f"sensors.{signal}", rig.sensors.get(signal, Sensor())) for signal in rig.sensed},
    )


def _check_differentiable(rig: Rig, coefficients: Sequence[str], period: float, readers: Mapping[str, Any]) -> None:
    """Reject effects and sensors without derivatives."""
    for use in rig.effects:
        corner: Callable[[Any, float, bool], str] | None = getattr(EFFECTS.load(use.name), "corner", None)
        if corner is not None:
            reason = corner(use.parameters, period, any(path.startswith(f"effects.{use.name}.") for path in coefficients))
            if reason:
                raise BadInput(f"{use.name} has {reason}", WHERE, "parameters with which a trajectory has derivatives")
    for signal, sensor in readers.items():
        for name in ("bandwidth", "delay"):
            if isinstance(getattr(sensor, name), Dual):
                what = f"the {name} of the sensor of {signal} is not differentiable"
                raise BadInput(what, WHERE, "coefficients of the plant, friction, other effects, or a sensor's gain and bias")
        if value_of(sensor.resolution) > 0.0:
            what = f"the sensor of {signal} has a resolution of {value_of(sensor.resolution):g}, so it reads in steps"
            raise BadInput(what, WHERE, "a resolution of 0, as in rig.quiet()")


class Given(NamedTuple):
    """Constants of a run; duals as rows, shape (…, width).

    Attributes:
        plant, friction, cylinder, valve: the parameters, which provide the names; () for a part without any.
        plant_rows, friction_rows, cylinder_rows, valve_rows, effect_rows: the parameters as duals.
        sensors: table of the sensors.
        period, step, steps: those of :class:`~ehls_ros.physics.simulator.Constants`.
    """

    plant: Any
    friction: Any
    cylinder: Any
    valve: Any
    plant_rows: Array
    friction_rows: Array
    cylinder_rows: Array
    valve_rows: Array
    effect_rows: Array
    sensors: Array
    period: float
    step: float
    steps: int


class Start(NamedTuple):
    """State of a run as in :class:`~ehls_ros.physics.simulator.State`; duals as rows, shape (…, width)."""

    y: Array
    mode: Array
    inputs: Array
    work: Array
    lagged: Array
    past: Array
    truth: Array
    measured: Array


class Prepared(NamedTuple):
    """A prepared run with derivatives, to be started once.

    Attributes:
        compiled: the compiled run.
        given, start: constants and state of the run.
        rows: the inputs, shape (n, 6).
        out: the readings as duals, without the derivatives by the sensors' coefficients, shape (n, signals, width).
        sensors: the sensors, with duals for their chosen coefficients.
        chosen: number of coefficients.
        members: names of the models and effects in the run, for error messages.
    """

    compiled: Callable[..., int]
    given: Given
    start: Start
    rows: Array
    out: Array
    sensors: Mapping[str, Sensor]
    chosen: int
    members: tuple[str, ...]

    def run(self) -> int:
        """Run the simulation and return the number of steps with more events than were located.

        Raises:
            BadInput: a compiled function performs an operation without derivative.
        """
        try:
            return self.compiled(self.given, self.start, self.rows, self.out)
        except NumbaError as error:
            last = str(error).strip().splitlines()[-1]
            what = f"a compiled function of {', '.join(self.members)} is not differentiable: {last}"
            raise BadInput(what, WHERE, "operations that ehls_ros.duals knows") from error

    def readings(self) -> Array:
        """Return the readings and their derivatives after the run, shape (n, signals, 1 + coefficients)."""
        found = self.out[:, :, : 1 + self.chosen].copy()
        for column, signal in enumerate(self.sensors):
            # The kernel's sensors hold no duals: a reading is gain · (sensed value) + bias.
            sensor = self.sensors[signal]
            seen = (found[:, column, 0] - value_of(sensor.bias)) / value_of(sensor.gain)
            for part, factor in ((sensor.gain, seen), (sensor.bias, np.ones(len(seen)))):
                for lane, tangent in tangents_of(part).items():
                    found[:, column, 1 + lane] += factor * tangent
        return found


def prepared(
    rig: Rig,
    coefficients: Sequence[str],
    inputs: Inputs,
    period: float = 1e-3,
    step: float | None = None,
    start: Mapping[str, float] | None = None,
) -> Prepared:
    """Prepare a run with the derivatives by some coefficients; arguments and errors are those of :func:`sensitivities`."""
    for path in (*coefficients, *(start or {})):
        _check(path, rig, start or {}, coefficients)
    varied = _varied(rig, coefficients).effective()
    _check_differentiable(rig, coefficients, period, varied.sensors)
    parts, plain = parts_of(rig), at_rest(rig, period, step)
    for path, value in (start or {}).items():
        plain.state.y[STARTS[path]] = value
    width = width_of(len(coefficients))
    state = _start(plain.state, width)
    pressures = varied.cylinder.law.at_rest(varied.cylinder.parameters, varied.plant)
    for place, value in enumerate(pressures, FRICTION + parts.numbers["elements"]):
        for lane, tangent in tangents_of(value).items():
            state.y[place, 1 + lane] = tangent
    for lane, path in enumerate(coefficients):
        if path in STARTS:
            state.y[STARTS[path], 1 + lane] = 1.0
    columns = [np.broadcast_to(np.asarray(c, dtype=np.float64), np.shape(inputs.command)) for c in inputs]
    rows = np.column_stack(columns)
    return Prepared(
        compiled(build, ENTRIES, parts.members, {**parts.numbers, "width": width}, parts.effects).run,
        _given(varied, plain, width),
        state,
        rows,
        np.zeros((len(rows), len(varied.sensed), width)),
        varied.sensors,
        len(coefficients),
        (rig.friction_model, *parts.effects.names),
    )


def _given(varied: EffectiveRig, plain: Simulated, width: int) -> Given:
    c = plain.constants
    effects = [value for use in varied.effects if use.name in plain.parts.effects.names for value in use.parameters]
    parts = (varied.plant, varied.friction, varied.cylinder.parameters, varied.valve.parameters)
    plant, friction, cylinder, valve = (record_rows(part, width) for part in parts)
    return Given(
        plant=c.plant,
        friction=c.friction,
        cylinder=c.cylinder,
        valve=c.valve,
        plant_rows=plant,
        friction_rows=friction,
        cylinder_rows=cylinder,
        valve_rows=valve,
        effect_rows=rows_of(effects, width),
        sensors=plain.state.sensors.table,
        period=c.period,
        step=c.step,
        steps=c.steps,
    )


def _start(state: State, width: int) -> Start:
    seen, size = state.sensors, state.y.size
    vectors = (rows_of(vector.tolist(), width) for vector in (state.y, seen.lagged, state.truth, state.measured))
    y, lagged, truth, measured = vectors
    work, past = np.zeros((state.work.shape[0], size, width)), np.zeros((*seen.past.shape, width))
    return Start(y, state.mode, state.inputs, work, lagged, past, truth, measured)


ENTRIES = {"run": "given, start, rows, out"}


class Compiled(NamedTuple):
    """The compiled ``run(given, start, rows, out)``; ``rows`` are the inputs, shape (n, 6)."""

    run: Callable[..., int]


def _duals_of(member: Any, width: int) -> Callable[..., Any]:
    """Build the function that returns the parameters of a cylinder or valve as duals; () without parameters."""

    @kernel
    def none(rows: Array, like: Any) -> Any:
        return like

    @kernel
    def duals(rows: Array, like: Any) -> Any:
        return dual_record(rows, width, like)

    return duals if member.Parameters._fields else none


def build(cylinder: Any, valve: Any, friction: Any, elements: int, states: int, chains: Chains, width: int) -> Compiled:
    """Build a plant's run with derivatives.

    Args:
        cylinder: module of the cylinder.
        valve: module of the valve.
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the effects.
        width: width of a dual.
    """
    plant = simulator.build(cylinder, valve, friction, elements, states, chains)
    cylinder_of, valve_of = _duals_of(cylinder, width), _duals_of(valve, width)
    advance, sense = plant.advance, plant.sense

    @kernel
    def run(given: Given, start: Start, rows: Array, out: Array) -> int:
        constants = Constants(
            dual_record(given.plant_rows, width, given.plant),
            dual_record(given.friction_rows, width, given.friction),
            dual_array(given.effect_rows, width),
            constant(given.period, width),
            constant(given.step, width),
            given.steps,
            0.0,
            cylinder_of(given.cylinder_rows, given.cylinder),
            valve_of(given.valve_rows, given.valve),
            (),
        )
        seen = sensors.SensorState(given.sensors, dual_array(start.lagged, width), dual_array(start.past, width))
        y, work, truth = dual_array(start.y, width), dual_array(start.work, width), dual_array(start.truth, width)
        measured, w = dual_array(start.measured, width), start.inputs
        state = State(y, start.mode, w, work, seen, truth, measured)
        written, noise, dense = dual_array(out, width), np.zeros(measured.size), 0
        for k in range(rows.shape[0]):
            w[TEMPERATURE] = rows[k, 5]
            sense(k, constants, state, noise)
            readings = written[k]
            for i in range(measured.size):
                readings[i] = measured[i]
            hold(w, k * given.period, rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4])
            dense += advance(k, constants, state)
        return dense

    return Compiled(run)
