"""The simulated rig: plant, sensors and their state, advanced one control period at a time.

If the actuator under test is a position servo, the plant is the loader coupled to it (:mod:`ehls_ros.physics.servo`).
"""

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any, Literal, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, contiguous, direct, kernel, kernel_no_refcount
from ehls_ros.physics import sensors
from ehls_ros.physics.composition import Effects, compiled, effects_of, rig_elements
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.integration import MAX_EVENTS, WORK_ROWS, integrator
from ehls_ros.physics.integration_step import steps_per_period
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import (
    FRICTION,
    INPUTS,
    PERIOD,
    PL,
    TEMPERATURE,
    XV,
    Chains,
    Coefficients,
    U,
    V,
    X,
    cycle_stepper,
    first_effect,
    hold,
    system,
)
from ehls_ros.physics.plausibility import implausible
from ehls_ros.physics.rig import EffectiveRig, Rig
from ehls_ros.physics.servo import CoupledCoefficients, Servo, ServoConstants, coupled_system, servo_command

ORDER: Literal[2, 4, 5] = 5
"""Order of the integration; justified by benchmarks/physics_convergence.py."""

OIL_TEMPERATURE = 313.15
"""Default oil temperature [K]."""


class Constants(NamedTuple):
    """Constants of a run.

    Attributes:
        plant: the effective rig's coefficients.
        friction: the effective rig's friction parameters.
        effects: ``p`` of the effects' chains.
        period: control period [s].
        step: integration step [s].
        steps: integration steps per period.
        warming: rate of the oil temperature [K/s].
        cylinder, valve: parameters of cylinder and valve; () if they have none.
        servo: :class:`~ehls_ros.physics.servo.ServoConstants` of the simulated position servo; () without one.
    """

    plant: Plant
    friction: Any
    effects: Any
    period: float
    step: float
    steps: int
    warming: float
    cylinder: Any = ()
    valve: Any = ()
    servo: Any = ()


class State(NamedTuple):
    """State of a run, updated in place; :mod:`ehls_ros.physics.plant` defines ``y``, ``mode`` and ``inputs``.

    Attributes:
        y: state of the plant, followed by that of the simulated position servo.
        mode: modes of the plant, followed by those of the servo.
        inputs: inputs of the plant, followed by those of the servo.
        work: workspace of the integrator.
        sensors: state of the sensors.
        truth: true values at the last sample, shape (signals,).
        measured: readings at the last sample, shape (signals,).
    """

    y: Array
    mode: Array
    inputs: Array
    work: Array
    sensors: sensors.SensorState
    truth: Array
    measured: Array


class Compiled(NamedTuple):
    """Compiled functions of a plant.

    Attributes:
        evaluate: from :func:`~ehls_ros.physics.plant.system`, or that of the coupled system.
        switch: from the same function as ``evaluate``.
        advance: ``advance(cycle, constants, state)`` integrates over one control period with the inputs held; returns the
            number of steps with more events than were located.
        sense: ``sense(cycle, constants, state, noise)`` writes the sensor readings to ``state.measured``.
        cycle: ``cycle(number, constants, state, command, row)`` sets the inputs of a control period and advances over it. The
            inputs are the loader's spool command [m] and, in ``row``, force [N], force rate [N/s], displacement [m] and
            velocity [m/s] of the actuator under test. If the servo is simulated, the row has the setpoints of displacement and
            velocity; they are overwritten by the actual values at the start of the period.
    """

    evaluate: Callable[..., float]
    switch: Callable[..., None]
    advance: Callable[..., int]
    sense: Callable[..., None]
    cycle: Callable[..., int]


def build(
    cylinder: Any, valve: Any, friction: Any, elements: int, states: int, chains: Chains, most_events: int = MAX_EVENTS
) -> Compiled:
    """Build a plant from a cylinder, a valve, a friction model and effects.

    Args:
        cylinder: module of the cylinder.
        valve: module of the valve.
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the effects.
        most_events: see :func:`~ehls_ros.physics.integration.integrator`.
    """
    end = first_effect(cylinder, elements)
    evaluate, switch = system(cylinder, valve, friction, elements, chains)
    run = integrator(evaluate, switch, size=end + states, most_events=most_events, order=ORDER)

    @kernel_no_refcount
    def run_held(t: float, y: Array, mode: Array, c: Any, command: float, step: float, steps: int, work: Array) -> int:
        held = Coefficients(c.plant, c.friction, c.inputs, c.effects, command, c.cylinder, c.valve)
        return run(t, y, mode, held, step, steps, work)

    step_cycle = cycle_stepper(run_held, chains, end)

    @kernel_no_refcount
    def advance(cycle: int, constants: Constants, state: State) -> int:
        c = coefficients(constants, state.inputs, 0.0)
        t = cycle * constants.period
        return step_cycle(t, state.y, state.mode, c, constants.step, constants.steps, state.work)

    @kernel_no_refcount
    def cycle(number: int, constants: Constants, state: State, command: float, row: Array) -> int:
        hold(state.inputs, number * constants.period, command, row[0], row[1], row[2], row[3])
        return advance(number, constants, state)

    return Compiled(evaluate, switch, advance, sensing(cylinder, valve, elements, chains), cycle)


@kernel
def coefficients(constants: Constants, inputs: Array, command: float) -> Coefficients:
    """Return the coefficients of the equations under a command [m]."""
    return Coefficients(
        constants.plant, constants.friction, inputs, constants.effects, command, constants.cylinder, constants.valve
    )


def build_coupled(cylinder: Any, valve: Any, friction: Any, elements: int, states: int, chains: Chains) -> Compiled:
    """Build the loader's plant coupled to a position servo; the arguments are those of :func:`build`."""
    end = first_effect(cylinder, elements)
    size = end + states
    evaluate, switch = coupled_system(cylinder, valve, friction, elements, states, chains)
    run = integrator(evaluate, switch, size=size + FRICTION + elements, order=ORDER)

    @kernel_no_refcount
    def run_held(t: float, y: Array, mode: Array, c: Any, command: float, step: float, steps: int, work: Array) -> int:
        held = CoupledCoefficients(c.plant, c.friction, c.inputs, c.effects, command, c.cylinder, c.valve, c.servo)
        return run(t, y, mode, held, step, steps, work)

    step_cycle = cycle_stepper(run_held, chains, end)

    @kernel_no_refcount
    def advance(cycle: int, constants: Constants, state: State) -> int:
        given, own = constants.servo, state.inputs[-INPUTS:]
        servo = Coefficients(given.plant, given.friction, own, (), own[U], (), ())
        c = CoupledCoefficients(
            constants.plant,
            constants.friction,
            state.inputs[:-INPUTS],
            constants.effects,
            0.0,
            constants.cylinder,
            constants.valve,
            servo,
        )
        t = cycle * constants.period
        return step_cycle(t, state.y, state.mode, c, constants.step, constants.steps, state.work)

    @kernel_no_refcount
    def cycle(number: int, constants: Constants, state: State, command: float, row: Array) -> int:
        servo, x, v, pressure = constants.servo, state.y[size + X], state.y[size + V], state.y[size + PL]
        own = state.inputs[-INPUTS:]
        own[U] = servo_command(row[2], row[3], x, pressure, servo.gain, servo.plant, servo.spool_limit)
        row[2], row[3] = x, v
        hold(state.inputs[:-INPUTS], number * constants.period, command, row[0], row[1], x, v)
        return advance(number, constants, state)

    return Compiled(evaluate, switch, advance, sensing(cylinder, valve, elements, chains), cycle)


def observing(cylinder: Any, valve: Any, elements: int, chains: Chains) -> Callable[..., None]:
    """Build the function ``observe(t, constants, state)`` that writes the true values of the sensed signals to ``state.truth``.

    Args:
        cylinder: module of the cylinder.
        valve: module of the valve.
        elements: number of the friction model's forces.
        chains: hooks of the effects.
    """
    end, piston_position, piston_velocity = first_effect(cylinder, elements), chains.piston_position, chains.piston_velocity
    sense_oil = cylinder.build(valve, chains, FRICTION + elements).sense

    @kernel_no_refcount
    def observe(t: float, constants: Constants, state: State) -> None:
        plant, p = constants.plant, constants.effects
        y, w, truth, z = state.y, state.inputs, state.truth, state.y[end:]
        sense_oil(t, y, z, coefficients(constants, w, 0.0), truth)
        truth[sensors.SPOOL], truth[sensors.OIL_TEMPERATURE] = y[XV], w[TEMPERATURE]
        truth[sensors.POSITION] = piston_position(y[X], t, y, w, z, p, plant)
        truth[sensors.VELOCITY] = piston_velocity(y[V], t, y, w, z, p, plant)

    return observe


def misreading(cylinder: Any, elements: int, chains: Chains) -> Callable[..., None]:
    """Build the function ``misread(t, constants, state, signals)`` that adds the effects' errors of readings to true signals.

    Args:
        cylinder: module of the cylinder.
        elements: number of the friction model's forces.
        chains: hooks of the effects.
    """
    position_reading, pressure_reading, force_reading = chains.position_reading, chains.pressure_reading, chains.force_reading
    end = first_effect(cylinder, elements)

    @kernel_no_refcount
    def misread(t: float, constants: Constants, state: State, signals: Array) -> None:
        y, w, z, p, plant = state.y, state.inputs, state.y[end:], constants.effects, constants.plant
        signals[sensors.POSITION] = position_reading(signals[sensors.POSITION], t, y, w, z, p, plant)
        signals[sensors.LOAD_PRESSURE] = pressure_reading(signals[sensors.LOAD_PRESSURE], t, y, w, z, p, plant)
        signals[sensors.FORCE] = force_reading(signals[sensors.FORCE], t, y, w, z, p, plant)

    return misread


def sensing(cylinder: Any, valve: Any, elements: int, chains: Chains) -> Callable[..., None]:
    """Build the function that reads the sensors; the arguments are those of :func:`observing`."""
    observe, misread = observing(cylinder, valve, elements, chains), misreading(cylinder, elements, chains)

    @kernel_no_refcount
    def sense(cycle: int, constants: Constants, state: State, noise: Array) -> None:
        t, truth = cycle * constants.period, state.truth
        observe(t, constants, state)
        position, pressure, force = truth[sensors.POSITION], truth[sensors.LOAD_PRESSURE], truth[sensors.FORCE]
        misread(t, constants, state, truth)
        sensors.measure(cycle, truth, noise, state.sensors, state.measured)
        # A wrong reading changes no truth.
        truth[sensors.POSITION], truth[sensors.LOAD_PRESSURE], truth[sensors.FORCE] = position, pressure, force

    return sense


ENTRIES = {"sense": "cycle, constants, state, noise", "cycle": "number, constants, state, command, row"}
"""Functions of a compiled plant that are called from Python, with their arguments."""


class PlantParts(NamedTuple):
    """Keyword arguments of :func:`~ehls_ros.physics.composition.compiled` for a plant."""

    members: dict[str, Any]
    numbers: dict[str, int]
    effects: Effects


def parts_of(rig: Rig | EffectiveRig) -> PlantParts:
    """Return the parts from which a rig's plant is compiled."""
    effects = effects_of(rig)
    model = FRICTION_MODELS.load(rig.friction_model)
    members = {"cylinder": rig.cylinder.law, "valve": rig.valve.law, "friction": model}
    return PlantParts(members, {"elements": rig_elements(rig), "states": effects.states}, effects)


def plant_kernel(parts: PlantParts, *, coupled: bool = False) -> ModuleType:
    """Return a compiled plant: a module with the functions of :class:`Compiled` named in :data:`ENTRIES`.

    Args:
        parts: parts from which it is compiled.
        coupled: whether the loader is coupled to a position servo.
    """
    return compiled(build_coupled if coupled else build, ENTRIES, **parts._asdict())


def earlier_commands(rig: Rig | EffectiveRig, period: float, *, lasting: bool = False) -> int:
    """Return the number of past commands that the rig's effects need.

    Args:
        rig: the rig.
        period: control period [s].
        lasting: whether the effects' parameters stay as they are; else they may become any.
    """
    delaying: list[tuple[Any, Any]] = [(EFFECTS.load(use.name), use.parameters) for use in rig.effects]
    reaches = [e.reach(p) if lasting else e.REACH for e, p in delaying if hasattr(e, "REACH")]
    return math.ceil(max(reaches, default=0.0) / period)


class Simulated(NamedTuple):
    """A rig prepared for its compiled plant.

    Attributes:
        rig: the effective rig.
        parts: parts from which its plant is compiled.
        constants: constants of the run.
        state: state of the run.
    """

    rig: EffectiveRig
    parts: PlantParts
    constants: Constants
    state: State


def at_rest(
    rig: Rig,
    period: float = 1e-3,
    step: float | None = None,
    position: float = 0.0,
    temperature: float = OIL_TEMPERATURE,
    warming: float = 0.0,
    servo: Servo | None = None,
) -> Simulated:
    """Return a rig at rest with zero load pressure.

    Args:
        rig: rig to simulate.
        period: control period [s].
        step: largest integration step [s], see :func:`~ehls_ros.physics.integration_step.steps_per_period`.
        position: initial piston position [m].
        temperature: initial oil temperature [K].
        warming: rate of the oil temperature [K/s].
        servo: position servo to simulate with the rig, of the same friction model; None if its motion is an input.
    """
    effective = rig.effective()
    parts = parts_of(rig)
    steps = steps_per_period(rig, period, step, servo)
    elements, states = parts.numbers["elements"], parts.numbers["states"]
    constants = Constants(
        effective.plant,
        effective.friction,
        parts.effects.parameters(effective.effects),
        float(period),
        period / steps,
        steps,
        float(warming),
        effective.cylinder.parameters,
        effective.valve.parameters,
    )
    cylinder = effective.cylinder.law
    own = cylinder.at_rest(effective.cylinder.parameters, effective.plant)
    y = np.concatenate([np.zeros(FRICTION + elements), own, np.zeros(states)])
    modes = effective.valve.law.MODES + cylinder.MODES
    state = State(
        y=y,
        mode=np.concatenate([np.ones(modes), np.zeros(elements)]),
        inputs=np.zeros(INPUTS + earlier_commands(effective, period)),
        work=np.empty((WORK_ROWS, y.size)),
        sensors=sensors.prepare(effective.sensors, period, effective.sensed),
        truth=np.zeros(len(effective.sensed)),
        measured=np.zeros(len(effective.sensed)),
    )
    state.y[X] = position
    state.inputs[PERIOD], state.inputs[TEMPERATURE] = period, temperature
    if servo is None:
        return Simulated(effective, parts, constants, state)
    coupled = ServoConstants(servo.rig.plant, servo.rig.friction, servo.gain, servo.rig.limits.spool)
    beside = np.zeros(FRICTION + elements)
    beside[X] = servo.start
    both = np.concatenate([state.y, beside])
    state = state._replace(
        y=both,
        mode=np.concatenate([state.mode, np.ones(1), np.zeros(elements)]),
        inputs=np.concatenate([state.inputs, np.zeros(INPUTS)]),
        work=np.empty((WORK_ROWS, both.size)),
    )
    return Simulated(effective, parts, constants._replace(servo=coupled), state)


class Simulator:
    """One simulated rig, advanced one control period at a time.

    Attributes:
        rig: the effective rig.
        constants: constants of the run.
        state: state of the run.
        period: control period [s].
        y: state of the plant, see :mod:`ehls_ros.physics.plant`.
        servo: state of the simulated position servo, in the same order; empty if there is none.
        mode: modes of the plant, then those of the servo.
        inputs: inputs of the plant, then those of the servo.
        truth: true values at the last sample, in the order of the rig's ``sensed``.
        acting: disturbance of the last period, as the arguments of :meth:`advance`; the actual motion of a simulated servo.
        cycle: number of control periods completed.
    """

    def __init__(
        self, rig: Rig, period: float = 1e-3, step: float | None = None, servo: Servo | None = None, **start: float
    ) -> None:
        """Compile or load the kernel and start at rest with zero load pressure.

        Args:
            rig: rig to simulate.
            period: control period [s].
            step: largest integration step [s], see :func:`~ehls_ros.physics.integration_step.steps_per_period`.
            servo: position servo to simulate with the rig, see :func:`at_rest`.
            **start: ``position``, ``temperature`` and ``warming`` of :func:`at_rest`.
        """
        self.rig, parts, self.constants, self.state = at_rest(rig, period, step, servo=servo, **start)
        plant = plant_kernel(parts, coupled=servo is not None)
        self._plant = plant
        self.period = self.constants.period
        size = first_effect(parts.members["cylinder"], parts.numbers["elements"]) + parts.numbers["states"]
        self.y, self.servo = self.state.y[:size], self.state.y[size:]
        self.mode, self.inputs, self.truth = self.state.mode, self.state.inputs, self.state.truth
        self.cycle = 0
        self.acting = np.zeros(4)
        # Compile now rather than in the first cycle.
        trial = at_rest(rig, period, step, servo=servo).state
        noise = np.zeros(self.truth.size)
        self._sense = direct(plant.sense, 0, self.constants, trial, noise)
        self._cycle = direct(plant.cycle, 0, self.constants, trial, 0.0, self.acting)
        self._sense(0, self.constants, trial, noise)
        self._cycle(0, self.constants._replace(steps=0), trial, 0.0, np.zeros(4))

    def measure(self, noise: Array) -> Array:
        """Read the sensors.

        Args:
            noise: standard normal numbers, shape (signals,).

        Returns:
            The readings in the order of the rig's ``sensed``; every call reuses the same array.
        """
        self._sense(self.cycle, self.constants, self.state, contiguous(noise))
        return self.state.measured

    def trouble(self) -> str:
        """Return the impossible reading among the last true values as text with advice; empty if there is none."""
        found = implausible(self.truth[np.newaxis], self.rig.limits)
        return "" if found is None else f"{found.what} (at {self.cycle * self.period:g} s)"

    def advance(self, command: float, force: float, force_rate: float, displacement: float, velocity: float) -> int:
        """Integrate over one control period.

        Args:
            command: spool command, held over the period [m].
            force: disturbance force at the start of the period [N].
            force_rate: rate of the disturbance force [N/s].
            displacement: displacement of the position servo at the start of the period [m]; if the servo is simulated, its
                position setpoint.
            velocity: velocity of the position servo, or the rate of its setpoint [m/s].

        Returns:
            Number of integration steps with more events than were located.
        """
        row = self.acting
        row[0], row[1], row[2], row[3] = force, force_rate, displacement, velocity
        dense: int = self._cycle(self.cycle, self.constants, self.state, command, row)
        self.inputs[TEMPERATURE] += self.constants.warming * self.period
        self.cycle += 1
        return dense
