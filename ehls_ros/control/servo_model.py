"""The motion to come of a position servo, and with it of the loader that it moves.

Two pistons joined by the beam's spring and damper. The servo follows its command by its own position loop; the loader is
taken to hold the force it is wanted to. Both move by the equations of :mod:`ehls_ros.control.state_estimator`, friction
included, each against the other's motion at the beginning of the cycle, extrapolated by its velocity and acceleration.

The model runs ahead to when a command sent now has acted for a cycle. What it hands to the law is the parabola through the force
now, then, and half way.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controllers.base import FORESEEN, Model, saturate
from ehls_ros.control.disturbances.position_servo import servo_command
from ehls_ros.control.state_estimator import (
    EXTERNAL,
    EXTERNAL_CURVATURE,
    EXTERNAL_RATE,
    FLOW_ERROR,
    MOST_ELEMENTS,
    STATES,
    Assumptions,
    move,
    rates,
)
from ehls_ros.physics.plant import PL, V, X

LENGTH = STATES + MOST_ELEMENTS

ACCELERATION = 0
"""Where :attr:`Piston.more` holds the acceleration [m/s^2]."""


LEAST_AHEAD = 2
"""Fewest cycles ahead, for a parabola."""

ROUNDING = 1e-9
"""Fraction of a period that counts as none."""


class Piston(NamedTuple):
    """One piston.

    Attributes:
        model: its rig.
        y: its state, as :class:`ehls_ros.control.state_estimator.State` has a mean.
        mode: modes of its friction elements.
        more: its acceleration [m/s^2], shape (1,).
        work: scratch, shape (5, LENGTH).
    """

    model: Model
    y: Array
    mode: Array
    more: Array
    work: Array


class Pair(NamedTuple):
    """Servo and loader.

    Attributes:
        servo: the actuator under test.
        loader: the loading piston; the bulk modulus of its model is 0, so that its pressure changes as wanted only.
        coupling: the beam.
        position_gain: of the servo's loop [1/s].
        started: 1 once both have a position, shape (1,).
        ahead: external force of the loader now and in the cycles to come [N], shape (cycles ahead + 1,).
    """

    servo: Piston
    loader: Piston
    coupling: Assumptions
    position_gain: float
    started: Array
    ahead: Array


class Motion(NamedTuple):
    """The compiled model."""

    foresee: Callable[..., None]


def piston(model: Model) -> Piston:
    """Return a piston at rest at 0."""
    return Piston(model, np.zeros(LENGTH), np.zeros(MOST_ELEMENTS), np.zeros(1), np.zeros((5, LENGTH)))


def pair(servo: Model, loader: Model, position_gain: float) -> Pair:
    """Return servo and loader before their first cycle.

    Args:
        servo: the servo's rig.
        loader: the loader's rig, which knows the coupling.
        position_gain: of the servo's loop [1/s].
    """
    rigid = loader._replace(plant=loader.plant._replace(bulk_modulus=0.0))
    beam = Assumptions(loader.coupling_stiffness, loader.coupling_damping, *([0.0] * (len(Assumptions._fields) - 2)))
    cycles = math.ceil(loader.command_delay / loader.period - ROUNDING) + 1
    return Pair(piston(servo), piston(rigid), beam, position_gain, np.zeros(1), np.zeros(max(cycles, LEAST_AHEAD) + 1))


@kernel
def pull(one: Piston, other: Piston, beam: Assumptions, supply: float) -> None:
    """Let one piston feel the other, and find its acceleration."""
    x, v, a = other.y[X], other.y[V], other.more[ACCELERATION]
    one.y[EXTERNAL] = -(beam.coupling_stiffness * x + beam.coupling_damping * v)
    one.y[EXTERNAL_RATE] = -(beam.coupling_stiffness * v + beam.coupling_damping * a)
    one.y[EXTERNAL_CURVATURE] = -beam.coupling_stiffness * a
    rates(one.y, one.mode, 0.0, supply, one.model, beam, one.work[0])
    one.more[ACCELERATION] = one.work[0, V]


def build(servo: Any) -> Motion:
    """Build the model.

    Args:
        servo: module of the servo, whose loop gives its command.
    """
    command_of = servo.servo_command

    @kernel
    def force_after(ahead: float, row: Array, command: Array, both: Pair) -> float:
        servo, loader, beam = both.servo, both.loader, both.coupling
        plant, period = servo.model.plant, servo.model.period
        area = loader.model.plant.piston_area
        loader.y[PL] = (row[0] + ahead * (row[1] + 0.5 * ahead * row[2])) / area
        loader.y[FLOW_ERROR] = (row[1] + ahead * row[2]) / area
        pull(loader, servo, beam, plant.supply_pressure)
        pull(servo, loader, beam, plant.supply_pressure)
        pull(loader, servo, beam, plant.supply_pressure)
        force = loader.y[EXTERNAL]
        wanted = command[0] + ahead * (command[1] + 0.5 * ahead * command[2])
        velocity = command[1] + ahead * command[2]
        spool = saturate(
            command_of(wanted, velocity, servo.y[X], servo.y[PL], both.position_gain, plant), servo.model.spool_limit
        )
        move(servo.y, servo.mode, spool, plant.supply_pressure, period, servo.model, beam, servo.work)
        move(loader.y, loader.mode, 0.0, plant.supply_pressure, period, loader.model, beam, loader.work)
        return force

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
                force[i] = force_after(i * period, row, command, both)
            to_middle, to_end = (force[middle] - force[0]) / near, (force[last] - force[0]) / far
            curvature = 2.0 * (to_end - to_middle) / (far - near)
            row[FORESEEN] = force[0]
            row[FORESEEN + 1] = to_middle - 0.5 * curvature * near
            row[FORESEEN + 2] = curvature

    return Motion(foresee)
