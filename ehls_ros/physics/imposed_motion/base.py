"""Shared definitions of the parts of the model along a recording."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
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
    """Recorded signals or their substitutes, each of shape (n,).

    Attributes:
        time: sample times [s].
        position: piston position [m].
        velocity: piston velocity [m/s].
        pressure: load pressure [Pa].
        spool: spool displacement [m].
        command: spool command, held until the next sample [m].
        disturbance: disturbance force [N].
        servo_position: displacement of the position servo [m].
        servo_velocity: velocity of the position servo [m/s].
        temperature: oil temperature [K].
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


class ModelRun(NamedTuple):
    """Recording and the model to run along it, all constant.

    Attributes:
        motion: the recording.
        fresh: whether a sample is the first of a contiguous stretch, where the states are initialised, shape (n,).
        period: sampling period [s].
        steps: integration steps per sample; 0 if there is nothing to integrate.
        history: number of past commands that the effects need.
        plant: the effective rig's coefficients.
        friction: the effective rig's friction parameters.
        effects: effects on the part.
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
    """Working arrays of a run: state, modes, inputs, rates of the measured states, and workspace of the integrator."""

    y: Array
    mode: Array
    w: Array
    slope: Array
    work: Array


@kernel
def scratch(size: int, modes: int, history: int) -> Scratch:
    """Return working arrays for a number of states, modes and past commands; all but the workspace are zero."""
    w, work = np.zeros(INPUTS + history), np.empty((WORK_ROWS, size))
    return Scratch(np.zeros(size), np.zeros(modes), w, np.zeros(FRICTION), work)


@kernel_no_refcount
def set_sample(k: int, a: ModelRun, y: Array, w: Array) -> None:
    """Set the measured states and the inputs to those of a sample.

    Args:
        k: index of the sample.
        a: the run.
        y: state; its first four entries are set.
        w: inputs, all set.
    """
    m, after = a.motion, min(k + 1, a.motion.time.size - 1)
    y[X], y[V], y[PL], y[XV] = m.position[k], m.velocity[k], m.pressure[k], m.spool[k]
    w[U], w[START], w[PERIOD] = m.command[k], m.time[k], a.period
    w[FD], w[FD_RATE] = m.disturbance[k], (m.disturbance[after] - m.disturbance[k]) * (1.0 / a.period)
    w[XD], w[VD], w[TEMPERATURE] = m.servo_position[k], m.servo_velocity[k], m.temperature[k]
    for i in range(w.size - INPUTS):
        w[INPUTS + i] = m.command[max(k - 1 - i, 0)]


@kernel_no_refcount
def write_slopes(k: int, a: ModelRun, slope: Array) -> None:
    """Write the rates of the measured states from sample ``k`` to the next, shape (4,); zero at the last sample."""
    m, after, rate = a.motion, min(k + 1, a.motion.time.size - 1), 1.0 / a.period
    slope[X] = (m.position[after] - m.position[k]) * rate
    slope[V] = (m.velocity[after] - m.velocity[k]) * rate
    slope[PL] = (m.pressure[after] - m.pressure[k]) * rate
    slope[XV] = (m.spool[after] - m.spool[k]) * rate


@kernel_no_refcount
def no_switch(t: float, y: Array, mode: Array, c: Imposed) -> None:
    """Do nothing: the system has no modes."""


def effect_integrator(equations: Relations, states: int) -> Callable[..., int]:
    """Build the integrator of the effects' states; the measured states change linearly.

    Args:
        equations: the equations of the plant.
        states: number of the effects' states.

    Returns:
        ``advance`` of :func:`~ehls_ros.physics.integration.integrator` for the four measured states followed by those of the
        effects, with :class:`Imposed` as ``c``.
    """
    rates = equations.effect_rates

    @kernel_no_refcount
    def evaluate(t: float, y: Array, mode: Array, c: Imposed, rate: Array) -> float:
        for i in range(FRICTION):
            rate[i] = c.slope[i]
        rates(t, y, y[FRICTION:], c.coefficients, rate[FRICTION:])
        return -1.0

    return integrator(evaluate, no_switch, size=FRICTION + states)


class Body(NamedTuple):
    """Result of the builder of a part, for floats and for duals.

    Attributes:
        run: ``run(a, inputs, s, own, out)`` writes the output, shape (n, columns), from a :class:`ModelRun` and the part's
            further inputs, with working arrays ``s`` and ``own``.
        states, modes: lengths of the state and of the modes in ``s``.
        own: length of both in ``own``.
    """

    run: Callable[..., None]
    states: int
    modes: int = 0
    own: int = 0


@kernel_no_refcount
def coefficients(a: ModelRun, w: Array) -> Coefficients:
    """Return the coefficients of the equations at the inputs ``w``; a recording has the one pressure of a double rod."""
    return Coefficients(a.plant, a.friction, w, a.effects, w[U], (), ())


def sampled(states: int, chains: Chains, write: Callable[[Relations], Callable[..., None]]) -> Body:
    """Build a part whose only states are those of the effects.

    Args:
        states: number of the effects' states.
        chains: hooks of the effects.
        write: returns, for given relations, a compiled ``write(t, y, z, c, row)`` that writes one sample's values.

    Returns:
        The part, which has no further inputs.
    """
    equations = relations(chains)
    advance, write_row = effect_integrator(equations, states), write(equations)

    @kernel_no_refcount
    def run_samples(a: ModelRun, inputs: None, s: Scratch, own: Scratch, out: Array) -> None:
        y, w, slope = s.y, s.w, s.slope
        for k in range(a.motion.time.size):
            set_sample(k, a, y, w)
            if a.fresh[k]:
                y[FRICTION:] = 0.0
            t, c = a.motion.time[k], coefficients(a, w)
            write_row(t, y, y[FRICTION:], c, out[k])
            if a.steps:
                write_slopes(k, a, slope)
                advance(t, y, s.mode, Imposed(c, slope), a.period / a.steps, a.steps, s.work)

    return Body(run_samples, FRICTION + states)
