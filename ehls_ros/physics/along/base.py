"""What the parts of the model share along a recording."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel, lean
from ehls_ros.physics.composition import Switched
from ehls_ros.physics.integration import WORK_ROWS, integrator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import (
    FD,
    FD_RATE,
    FRICTION,
    INPUTS,
    PERIOD,
    PL,
    START,
    TEMPERATURE,
    VD,
    XD,
    XV,
    Chains,
    Coefficients,
    Relations,
    U,
    V,
    X,
    relations,
)
from ehls_ros.samples import Mask


class Motion(NamedTuple):
    """What was measured, or is taken for it, each of shape (n,).

    Attributes:
        time: of the samples [s].
        position: of the piston [m].
        velocity: of the piston [m/s].
        pressure: load pressure [Pa].
        spool: spool displacement [m].
        command: spool command, held from its sample on [m].
        disturbance: disturbance force [N].
        servo_position: displacement of the position servo [m].
        servo_velocity: its velocity [m/s].
        temperature: of the oil [K].
    """

    time: Array
    position: Array
    velocity: Array
    pressure: Array
    spool: Array
    command: Array
    disturbance: Array
    servo_position: Array
    servo_velocity: Array
    temperature: Array


class Along(NamedTuple):
    """A recording and the model to run along it; nothing of it changes.

    Attributes:
        motion: the recording.
        fresh: samples at which a stretch begins, of whose past nothing is known, shape (n,).
        period: time between two samples [s].
        steps: integration steps a sample; 0 where nothing has to be integrated.
        history: number of earlier commands the effects look back on.
        plant: of the effective rig.
        friction: of the effective rig.
        effects: those of the part.
    """

    motion: Motion
    fresh: Mask
    period: float
    steps: int
    history: int
    plant: Plant
    friction: Any
    effects: Switched


class Imposed(NamedTuple):
    """:class:`~ehls_ros.physics.plant.Coefficients` and the rates of the measured states, shape (4,)."""

    coefficients: Coefficients
    slope: Array


class Scratch(NamedTuple):
    """What a run changes: a state, modes, inputs, rates of the measured states, and scratch of an integrator."""

    y: Array
    mode: Array
    w: Array
    slope: Array
    work: Array


@kernel
def scratch(size: int, modes: int, history: int) -> Scratch:
    """Return what a run changes, all zero, for a state of a size, a number of modes and one of earlier commands."""
    w, work = np.zeros(INPUTS + history), np.empty((WORK_ROWS, size))
    return Scratch(np.zeros(size), np.zeros(modes), w, np.zeros(FRICTION), work)


@lean
def take(k: int, a: Along, y: Array, w: Array) -> None:
    """Take a sample.

    Args:
        k: its number.
        a: the run.
        y: state; its measured part is set.
        w: inputs, which hold until the next sample.
    """
    m, after = a.motion, min(k + 1, a.motion.time.size - 1)
    y[X], y[V], y[PL], y[XV] = m.position[k], m.velocity[k], m.pressure[k], m.spool[k]
    w[U], w[START], w[PERIOD] = m.command[k], m.time[k], a.period
    w[FD], w[FD_RATE] = m.disturbance[k], (m.disturbance[after] - m.disturbance[k]) * (1.0 / a.period)
    w[XD], w[VD], w[TEMPERATURE] = m.servo_position[k], m.servo_velocity[k], m.temperature[k]
    for i in range(w.size - INPUTS):
        w[INPUTS + i] = m.command[max(k - 1 - i, 0)]


@lean
def lead(k: int, a: Along, slope: Array) -> None:
    """Write the rates of the measured states from a sample to the next, shape (4,); zero after the last."""
    m, after, rate = a.motion, min(k + 1, a.motion.time.size - 1), 1.0 / a.period
    slope[X] = (m.position[after] - m.position[k]) * rate
    slope[V] = (m.velocity[after] - m.velocity[k]) * rate
    slope[PL] = (m.pressure[after] - m.pressure[k]) * rate
    slope[XV] = (m.spool[after] - m.spool[k]) * rate


@lean
def never(t: float, y: Array, mode: Array, c: Imposed) -> None:
    """Switch nothing: the system has no modes."""


def memory(equations: Relations, states: int) -> Callable[..., int]:
    """Build the integrator of the effects' own states, the measured states straight on.

    Args:
        equations: the relations.
        states: number of the effects' own states.

    Returns:
        ``advance`` of :func:`~ehls_ros.physics.integration.integrator`, for a state of the four measured ones and the
        effects' own, with :class:`Imposed` as ``c``.
    """
    rates = equations.memory

    @lean
    def evaluate(t: float, y: Array, mode: Array, c: Imposed, rate: Array) -> float:
        for i in range(FRICTION):
            rate[i] = c.slope[i]
        rates(t, y, y[FRICTION:], c.coefficients, rate[FRICTION:])
        return -1.0

    return integrator(evaluate, never, size=FRICTION + states)


class Sampled(NamedTuple):
    """A part that follows from each sample and what effects remember."""

    run: Callable[..., None]


def sampled(states: int, chains: Chains, write: Callable[[Relations], Callable[..., None]]) -> Sampled:
    """Build a part that has no states but the effects' own.

    Args:
        states: number of these.
        chains: the effects.
        write: returns, for the relations, a compiled ``write(t, y, z, c, row)`` of one sample's values.

    Returns:
        Its ``run(a, out)``, which fills ``out``, shape (n, columns).
    """
    equations = relations(chains)
    remember, fill = memory(equations, states), write(equations)

    @lean
    def go(a: Along, s: Scratch, out: Array) -> None:
        y, w, slope = s.y, s.w, s.slope
        for k in range(a.motion.time.size):
            take(k, a, y, w)
            if a.fresh[k]:
                y[FRICTION:] = 0.0
            t, c = a.motion.time[k], Coefficients(a.plant, a.friction, w, a.effects, w[U])
            fill(t, y, y[FRICTION:], c, out[k])
            if a.steps:
                lead(k, a, slope)
                remember(t, y, s.mode, Imposed(c, slope), a.period / a.steps, a.steps, s.work)

    @kernel
    def run(a: Along, out: Array) -> None:
        go(a, scratch(FRICTION + states, 0, a.history), out)

    return Sampled(run)
