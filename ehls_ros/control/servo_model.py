"""The motion to come of a position servo, and with it of the loader that it moves.

Two pistons joined by the beam's spring and damper. The servo follows its command by its own position loop; the loader is
taken to hold the force it is wanted to. Both move by the equations of :mod:`ehls_ros.control.state_estimator`, friction
included. As in the node graph, they exchange their motion once a cycle: the servo feels a force held over the cycle, the
loader a far end that goes on at its velocity.

The model runs ahead to when a command sent now has acted for a cycle. What it hands to the law is the parabola that has the
force's mean over the present cycle, over the one that begins then, and over the one half way: between two samples the loader
is moved by the force's impulse, not by its value at the sample.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controllers.base import FORESEEN, Model, saturate
from ehls_ros.control.state_estimator import (
    EXTERNAL,
    EXTERNAL_RATE,
    FLOW_ERROR,
    MOST_ELEMENTS,
    ROUNDING,
    STATES,
    Assumptions,
    move,
)
from ehls_ros.physics.plant import PL, V, X

LENGTH = STATES + MOST_ELEMENTS

LEAST_AHEAD = 2
"""Fewest cycles ahead, for a parabola."""


class Piston(NamedTuple):
    """One piston.

    Attributes:
        model: its rig.
        surroundings: what holds it besides the external force.
        y: its state, as :class:`ehls_ros.control.state_estimator.State` has a mean.
        mode: modes of its friction elements.
        work: scratch, shape (5, LENGTH).
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
        loader: the loading piston; the bulk modulus of its model is 0, so that its pressure changes as wanted only.
        position_gain: of the servo's loop [1/s].
        started: 1 once both have a position, shape (1,).
        ahead: mean external force of the loader over the present cycle and those to come [N], shape (cycles ahead + 1,).
    """

    servo: Piston
    loader: Piston
    position_gain: float
    started: Array
    ahead: Array


class Motion(NamedTuple):
    """The compiled model: ``foresee(rows, commands, pair)`` writes the force foreseen into some rows on end."""

    foresee: Callable[..., None]


def piston(model: Model, stiffness: float, damping: float) -> Piston:
    """Return a piston at rest at 0, held by a spring [N/m] and a damper [N s/m]."""
    held = Assumptions(stiffness, damping, *([0.0] * (len(Assumptions._fields) - 2)))
    return Piston(model, held, np.zeros(LENGTH), np.zeros(MOST_ELEMENTS), np.zeros((5, LENGTH)))


def pair(servo: Model, loader: Model, position_gain: float) -> Pair:
    """Return servo and loader before their first cycle.

    Args:
        servo: the servo's rig.
        loader: the loader's rig, which knows the coupling.
        position_gain: of the servo's loop [1/s].
    """
    as_wanted = loader._replace(plant=loader.plant._replace(bulk_modulus=0.0))
    loading = piston(as_wanted, loader.coupling_stiffness, loader.coupling_damping)
    cycles = max(LEAST_AHEAD, math.ceil(loader.command_delay / loader.period - ROUNDING) + 1)
    return Pair(piston(servo, 0.0, 0.0), loading, position_gain, np.zeros(1), np.zeros(cycles + 1))


def build(law: Any) -> Motion:
    """Build the model.

    Args:
        law: module of the servo, which has the law of its loop.
    """
    servo_command = law.servo_command

    @kernel
    def mean_after(ahead: float, row: Array, command: Array, both: Pair) -> float:
        servo, loader, period = both.servo, both.loader, both.servo.model.period
        plant, beam = servo.model.plant, loader.surroundings
        x, v = servo.y[X], servo.y[V]
        force = -(beam.coupling_stiffness * x + beam.coupling_damping * v)
        rate = -beam.coupling_stiffness * v
        loader.y[EXTERNAL], loader.y[EXTERNAL_RATE] = force, rate
        servo.y[EXTERNAL] = beam.coupling_stiffness * (x - loader.y[X]) + beam.coupling_damping * (v - loader.y[V])
        area = loader.model.plant.piston_area
        loader.y[PL] = (row[0] + ahead * (row[1] + 0.5 * ahead * row[2])) / area
        loader.y[FLOW_ERROR] = (row[1] + ahead * row[2]) / area
        wanted = command[0] + ahead * (command[1] + 0.5 * ahead * command[2])
        velocity = command[1] + ahead * command[2]
        spool = servo_command(wanted, velocity, x, servo.y[PL], both.position_gain, plant)
        limited = saturate(spool, servo.model.spool_limit)
        move(servo.y, servo.mode, limited, plant.supply_pressure, period, servo.model, servo.surroundings, servo.work)
        move(loader.y, loader.mode, 0.0, plant.supply_pressure, period, loader.model, beam, loader.work)
        return force + 0.5 * period * rate

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
