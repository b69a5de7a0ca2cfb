"""Predict the motion of a position servo, and with it of the loader that it moves.

Two pistons are coupled by the spring and damper of the beam. The servo follows its command by its position loop, which is
sampled once per cycle; the loader is assumed to hold its wanted force. Both follow the equations of
:mod:`ehls_ros.control.state_estimator`, including friction, in joint Runge-Kutta steps with coupling at every stage. Friction
changes its modes at the ends of steps. The model shares no integrator with the simulator.

The prediction reaches to one cycle after a command sent now begins to act. The law receives the parabola with the force's mean
over the present cycle, over the one that begins then, and over the one halfway: between two samples the loader is moved by the
force's impulse, not by its value at the sample.
"""

import math
from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.control.controllers.base import FORESEEN, Model
from ehls_ros.control.state_estimator import (
    EXTERNAL,
    FLOW_ERROR,
    MAX_ELEMENTS,
    MAX_MEAN_STEP,
    ROUNDING,
    STATES,
    Assumptions,
    elements,
    rates,
    switch,
)
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.plant import PL, V, X
from ehls_ros.physics.servo import servo_command

LENGTH = STATES + MAX_ELEMENTS

MIN_AHEAD = 2
"""Fewest cycles of prediction, as required for a parabola."""


class Piston(NamedTuple):
    """State of one piston.

    Attributes:
        model: model of its rig.
        surroundings: coupling of the piston besides the external force.
        y: its state, in the layout of a mean in :class:`ehls_ros.control.state_estimator.State`.
        mode: modes of its friction elements.
        work: a state within a step, then the rates of the step's four stages, shape (5, LENGTH).
    """

    model: Model
    surroundings: Assumptions
    y: Array
    mode: Array
    work: Array


class Pair(NamedTuple):
    """Servo and loader.

    Attributes:
        servo: the actuator under test.
        loader: the loading piston; its bulk modulus is set to 0, so that its pressure follows only the wanted force.
        position_gain: gain of the servo's position loop [1/s].
        started: 1 once both have a position, shape (1,).
        ahead: mean external force of the loader over the present and the predicted cycles [N], shape (cycles ahead + 1,).
    """

    servo: Piston
    loader: Piston
    position_gain: float
    started: Array
    ahead: Array


class Motion(NamedTuple):
    """Compiled model; ``foresee(rows, commands, pair)`` writes the foreseen force into consecutive rows."""

    foresee: Callable[..., None]


def piston(model: Model, stiffness: float, damping: float) -> Piston:
    """Return a piston at rest at 0, held by a spring [N/m] and a damper [N s/m]."""
    zeros = Assumptions._make([0.0] * len(Assumptions._fields))
    held = zeros._replace(coupling_stiffness=stiffness, coupling_damping=damping, actuator_mass=math.inf)
    return Piston(model, held, np.zeros(LENGTH), np.zeros(MAX_ELEMENTS), np.zeros((5, LENGTH)))


def pair(servo: Model, loader: Model, position_gain: float) -> Pair:
    """Return servo and loader before their first cycle.

    Args:
        servo: model of the servo's rig.
        loader: model of the loader's rig, including the coupling.
        position_gain: gain of the servo's position loop [1/s].
    """
    as_wanted = loader._replace(plant=loader.plant._replace(bulk_modulus=0.0))
    loading = piston(as_wanted, loader.coupling_stiffness, loader.coupling_damping)
    cycles = max(MIN_AHEAD, math.ceil(loader.command_delay / loader.period - ROUNDING) + 1)
    return Pair(piston(servo, 0.0, 0.0), loading, position_gain, np.zeros(1), np.zeros(cycles + 1))


def build() -> Motion:
    """Build the compiled model."""

    @kernel_no_refcount
    def evaluate(stage: int, spool: float, x: Array, y: Array, both: Pair) -> float:
        """Write the rates of a stage at states of servo and loader; return the external force of the loader [N]."""
        servo, loader, beam = both.servo, both.loader, both.loader.surroundings
        supply = servo.model.plant.supply_pressure
        far = beam.coupling_stiffness * x[X] + beam.coupling_damping * x[V]
        x[EXTERNAL], y[EXTERNAL] = far - beam.coupling_stiffness * y[X] - beam.coupling_damping * y[V], -far
        rates(x, servo.mode, spool, supply, servo.model, servo.surroundings, servo.work[stage])
        rates(y, loader.mode, 0.0, supply, loader.model, beam, loader.work[stage])
        return -far

    @kernel_no_refcount
    def go(piston: Piston, stage: int, step: float) -> None:
        """Write the state after a step at the rates of a stage to the first row of the work array."""
        work = piston.work
        for i in range(STATES + elements(piston.model.friction)):
            work[0, i] = piston.y[i] + step * work[stage, i]

    @kernel_no_refcount
    def end(piston: Piston, step: float) -> None:
        """Advance a piston by a step at the weighted mean of all stages' rates."""
        work = piston.work
        for i in range(STATES + elements(piston.model.friction)):
            piston.y[i] += step / 6.0 * (work[1, i] + 2.0 * work[2, i] + 2.0 * work[3, i] + work[4, i])
        switch(piston.y, piston.mode, piston.model.friction)

    @kernel_no_refcount
    def move(spool: float, step: float, both: Pair) -> float:
        """Advance both by a step of the classical Runge-Kutta method; return the mean external force of the loader [N]."""
        servo, loader = both.servo, both.loader
        force = evaluate(1, spool, servo.y, loader.y, both)
        for stage in range(2, 5):
            part = step if stage == 4 else 0.5 * step
            go(servo, stage - 1, part)
            go(loader, stage - 1, part)
            force += (1.0 if stage == 4 else 2.0) * evaluate(stage, spool, servo.work[0], loader.work[0], both)
        end(servo, step)
        end(loader, step)
        return force / 6.0

    @kernel_no_refcount
    def mean_after(ahead: float, row: Array, command: Array, both: Pair) -> float:
        servo, loader, period = both.servo, both.loader, both.servo.model.period
        plant, area = servo.model.plant, loader.model.plant.piston_area
        loader.y[PL] = (row[0] + ahead * (row[1] + 0.5 * ahead * row[2])) / area
        loader.y[FLOW_ERROR] = (row[1] + ahead * row[2]) / area
        wanted = command[0] + ahead * (command[1] + 0.5 * ahead * command[2])
        velocity = command[1] + ahead * command[2]
        x, limit = servo.y[X], servo.model.spool_limit
        spool = servo_command(wanted, velocity, x, servo.y[PL], both.position_gain, plant, limit)
        steps = max(1, math.ceil((period - ROUNDING) / MAX_MEAN_STEP))
        step, total = period / steps, 0.0
        for _ in range(steps):
            total += move(spool, step, both)
        return total / steps

    @kernel
    def foresee(rows: Array, commands: Array, both: Pair) -> None:
        servo, loader, force, period = both.servo, both.loader, both.ahead, both.servo.model.period
        last = len(force) - 1
        middle = last // 2
        near, far = middle * period, last * period
        for k in range(len(rows)):
            row, command = rows[k], commands[k]
            if not math.isfinite(command[0] + command[1] + command[2]):
                both.started[0] = 0.0
                row[FORESEEN:] = np.nan
                continue
            first = last
            if both.started[0] == 0.0:
                both.started[0] = 1.0
                servo.y[:], loader.y[:] = 0.0, 0.0
                servo.mode[:], loader.mode[:] = 0.0, 0.0
                servo.y[X] = loader.y[X] = command[0]
                first = 0
            for i in range(last):
                force[i] = force[i + 1]
            for i in range(first, last + 1):
                force[i] = mean_after(i * period, row, command, both)
            to_middle, to_end = (force[middle] - force[0]) / near, (force[last] - force[0]) / far
            curvature = 2.0 * (to_end - to_middle) / (far - near)
            rate = to_middle - 0.5 * curvature * (near + period)
            row[FORESEEN] = force[0] - period * (0.5 * rate + curvature * period / 6.0)
            row[FORESEEN + 1] = rate
            row[FORESEEN + 2] = curvature

    return Motion(foresee)


def servo_kernel() -> ModuleType:
    """Return a module with ``foresee``, the compiled preview of the motion of a position servo and the loader."""
    return compiled(build, {"foresee": "rows, commands, both"})
