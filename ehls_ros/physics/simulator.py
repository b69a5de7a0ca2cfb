"""A rig that can be stepped: plant kernel, state, inputs and sensors together."""

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, lean
from ehls_ros.physics import sensors
from ehls_ros.physics.composition import Effects, compiled, effects_of, rig_elements
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.integration import MOST_EVENTS, WORK_ROWS, integrator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import FRICTION, INPUTS, PERIOD, TEMPERATURE, Chains, Coefficients, V, X, hold, mover, system
from ehls_ros.physics.plausibility import implausible
from ehls_ros.physics.rig import SENSED, EffectiveRig, Rig

DEFAULT_STEP = 1e-4
"""Integration step [s]; benchmarks/physics_convergence.py shows why."""

OIL_TEMPERATURE = 313.15
"""Oil temperature where nothing is said [K]."""


class Standing(NamedTuple):
    """What stands during a run.

    Attributes:
        plant: of the effective rig.
        friction: of the effective rig.
        effects: ``p`` of the effects' chains.
        period: control period [s].
        step: integration step [s].
        steps: integration steps a period.
        warming: rate at which the oil warms [K/s].
    """

    plant: Plant
    friction: Any
    effects: Any
    period: float
    step: float
    steps: int
    warming: float


class Moving(NamedTuple):
    """What a run changes, in place.

    Attributes:
        y: state as :mod:`ehls_ros.physics.plant` lays it out.
        mode: modes as there.
        inputs: inputs as there.
        work: scratch of the integrator.
        sensors: what the sensors remember.
        truth: what they last measured, shape (signals,).
        measured: what they made of it, shape (signals,).
    """

    y: Array
    mode: Array
    inputs: Array
    work: Array
    sensors: sensors.SensorState
    truth: Array
    measured: Array


class Compiled(NamedTuple):
    """A plant's compiled functions.

    Attributes:
        evaluate: of :func:`~ehls_ros.physics.plant.system`.
        switch: likewise.
        advance: ``advance(cycle, standing, moving)`` goes on by a control period under the inputs held; returns the number of
            steps in which events came too densely to be located.
        sense: ``sense(cycle, standing, moving, noise)`` reads the sensors into ``moving.measured``.
        hold: of :mod:`ehls_ros.physics.plant`.
    """

    evaluate: Callable[..., float]
    switch: Callable[..., None]
    advance: Callable[..., int]
    sense: Callable[..., None]
    hold: Callable[..., None]


def build(friction: Any, elements: int, states: int, chains: Chains, most_events: int = MOST_EVENTS) -> Compiled:
    """Build a plant of chosen parts.

    Args:
        friction: the friction model's file.
        elements: number of its forces.
        states: number of the effects' own states.
        chains: the effects.
        most_events: of :func:`~ehls_ros.physics.integration.integrator`.
    """
    end = FRICTION + elements
    evaluate, switch = system(friction, elements, chains)
    run = integrator(evaluate, switch, size=end + states, most_events=most_events)
    supply_pressure, piston_position, piston_velocity = chains.supply_pressure, chains.piston_position, chains.piston_velocity

    @lean
    def under(t: float, y: Array, mode: Array, c: Any, command: float, step: float, steps: int, work: Array) -> int:
        return run(t, y, mode, Coefficients(c.plant, c.friction, c.inputs, c.effects, command), step, steps, work)

    move = mover(under, chains, end)

    @lean
    def advance(cycle: int, standing: Standing, moving: Moving) -> int:
        c = Coefficients(standing.plant, standing.friction, moving.inputs, standing.effects, 0.0)
        t = cycle * standing.period
        return move(t, moving.y, moving.mode, c, standing.step, standing.steps, moving.work)

    @lean
    def sense(cycle: int, standing: Standing, moving: Moving, noise: Array) -> None:
        t, plant, p = cycle * standing.period, standing.plant, standing.effects
        y, w, truth, z = moving.y, moving.inputs, moving.truth, moving.y[end:]
        supply = supply_pressure(plant.supply_pressure, t, y, w, z, p, plant)
        sensors.true_signals(y, w[TEMPERATURE], supply, plant, truth)
        truth[sensors.POSITION] = piston_position(y[X], t, y, w, z, p, plant)
        truth[sensors.VELOCITY] = piston_velocity(y[V], t, y, w, z, p, plant)
        sensors.measure(cycle, truth, noise, moving.sensors, moving.measured)

    return Compiled(evaluate, switch, advance, sense, hold)


ENTRIES = {
    "advance": "cycle, standing, moving",
    "sense": "cycle, standing, moving, noise",
    "hold": "w, start, command, force, force_rate, displacement, velocity",
}
"""Entries of a compiled plant, with their arguments."""


class PlantParts(NamedTuple):
    """What a plant is compiled of: keywords of :func:`~ehls_ros.physics.composition.compiled`."""

    members: dict[str, Any]
    numbers: dict[str, int]
    effects: Effects


def parts_of(rig: Rig | EffectiveRig) -> PlantParts:
    """Return what a rig's plant is compiled of."""
    effects = effects_of(rig)
    model = FRICTION_MODELS.load(rig.friction_model)
    return PlantParts({"friction": model}, {"elements": rig_elements(rig), "states": effects.states}, effects)


def plant_kernel(parts: PlantParts) -> ModuleType:
    """Return a compiled plant, with the entries of :class:`Compiled` that :data:`ENTRIES` names."""
    return compiled(build, ENTRIES, **parts._asdict())


def earlier_commands(rig: Rig | EffectiveRig, period: float) -> int:
    """Return how many commands sent before the present one the rig's effects look back on.

    Args:
        rig: the rig.
        period: control period [s].
    """
    reach = max((getattr(EFFECTS.load(use.name), "REACH", 0.0) for use in rig.effects), default=0.0)
    return math.ceil(reach / period)


class Simulated(NamedTuple):
    """A rig as a compiled plant takes it.

    Attributes:
        rig: the effective rig.
        parts: what its plant is compiled of.
        standing: what stands during the run.
        moving: what the run changes.
    """

    rig: EffectiveRig
    parts: PlantParts
    standing: Standing
    moving: Moving


def at_rest(
    rig: Rig,
    period: float = 1e-3,
    step: float = DEFAULT_STEP,
    position: float = 0.0,
    temperature: float = OIL_TEMPERATURE,
    warming: float = 0.0,
) -> Simulated:
    """Return a rig that rests without pressure.

    Args:
        rig: rig to simulate.
        period: control period [s].
        step: largest integration step [s]; the period is cut into equal steps no longer.
        position: initial piston position [m].
        temperature: initial oil temperature [K].
        warming: rate at which the oil warms [K/s].
    """
    effective = rig.effective()
    parts = parts_of(rig)
    steps = max(1, math.ceil(period / step - 1e-9))
    elements, states = parts.numbers["elements"], parts.numbers["states"]
    standing = Standing(
        effective.plant,
        effective.friction,
        parts.effects.parameters(effective.effects),
        float(period),
        period / steps,
        steps,
        float(warming),
    )
    y = np.zeros(FRICTION + elements + states)
    moving = Moving(
        y=y,
        mode=np.zeros(1 + elements),
        inputs=np.zeros(INPUTS + earlier_commands(effective, period)),
        work=np.empty((WORK_ROWS, y.size)),
        sensors=sensors.prepare(effective.sensors, period),
        truth=np.zeros(len(SENSED)),
        measured=np.zeros(len(SENSED)),
    )
    moving.y[X], moving.mode[0] = position, 1.0
    moving.inputs[PERIOD], moving.inputs[TEMPERATURE] = period, temperature
    return Simulated(effective, parts, standing, moving)


class Simulator:
    """One simulated rig, advanced a control period at a time.

    Attributes:
        rig: the effective rig.
        standing: what stands during the run.
        moving: what the run changes.
        period: control period [s].
        y: state as :mod:`ehls_ros.physics.plant` lays it out.
        mode: modes as there.
        inputs: inputs as there.
        truth: what the sensors last measured, in the order of ``SENSED``.
        cycle: number of control periods done.
    """

    def __init__(self, rig: Rig, period: float = 1e-3, step: float = DEFAULT_STEP, **start: float) -> None:
        """Prepare and compile (or load) the kernel; the rig rests without pressure.

        Args:
            rig: rig to simulate.
            period: control period [s].
            step: largest integration step [s]; the period is cut into equal steps no longer.
            **start: ``position``, ``temperature`` and ``warming`` of :func:`at_rest`.
        """
        self.rig, parts, self.standing, self.moving = at_rest(rig, period, step, **start)
        plant = plant_kernel(parts)
        self._advance, self._sense, self._hold = plant.advance, plant.sense, plant.hold
        self.period = self.standing.period
        self.y, self.mode, self.inputs, self.truth = self.moving.y, self.moving.mode, self.moving.inputs, self.moving.truth
        self.cycle = 0
        # What would otherwise compile in the first cycle.
        trial = at_rest(rig, period, step).moving
        self._sense(0, self.standing, trial, np.zeros(len(SENSED)))
        self._hold(trial.inputs, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._advance(0, self.standing._replace(steps=0), trial)

    def measure(self, noise: Array) -> Array:
        """Read the sensors at the present cycle.

        Args:
            noise: standard normal numbers, shape (signals,).

        Returns:
            The readings in the order of ``SENSED``; the same array every time.
        """
        self._sense(self.cycle, self.standing, self.moving, noise)
        return self.moving.measured

    def trouble(self) -> str:
        """Return what cannot be true of the rig as it was last measured, with advice; empty if nothing."""
        found = implausible(self.truth[np.newaxis], self.rig.limits)
        return "" if found is None else f"{found.what} (at {self.cycle * self.period:g} s)"

    def advance(self, command: float, force: float, force_rate: float, displacement: float, velocity: float) -> int:
        """Go on by one control period.

        Args:
            command: spool command, held [m].
            force: disturbance force now [N].
            force_rate: and its rate [N/s].
            displacement: displacement of the position servo now [m].
            velocity: and its velocity [m/s].

        Returns:
            Number of integration steps in which events came too densely to be located.
        """
        self._hold(self.inputs, self.cycle * self.period, command, force, force_rate, displacement, velocity)
        dense: int = self._advance(self.cycle, self.standing, self.moving)
        self.inputs[TEMPERATURE] += self.standing.warming * self.period
        self.cycle += 1
        return dense
