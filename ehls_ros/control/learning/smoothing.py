"""Estimate the external force of past cycles from earlier and later readings, by a filter and a smoother.

The filter is that of :mod:`ehls_ros.control.state_estimator`, with the assumptions of the law without preview. Its immediate
estimate lags behind and is noisy. Some cycles later more readings contain information on the same cycle, and a smoother passes
backwards through the filter's steps with them. The timing of the smoothed force is accurate to a fraction of a cycle, which is
decisive for a foreseen force: one of 5 kN at 1 Hz that comes a millisecond late is 30 N wrong.

The backward pass starts with a = 0 after the last reading. A reading with innovation e, its variance S, gain k and output
vector h makes a := a - h (e/S + k a); a step of the model with the transition Phi makes a := Phi' a. The smoothed mean is the
filtered one minus P a.

Source: Bierman, Fixed interval smoothing with discrete measurements, International Journal of Control 18, 1973.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from ehls_ros.arrays import Array, copy, kernel, separate_kernel
from ehls_ros.control import process_noise, state_estimator
from ehls_ros.control.controllers.base import Model
from ehls_ros.control.state_estimator import (
    CELL_OFFSET,
    EXTERNAL,
    MAX_COVARIANCE_STEP,
    ROUNDING,
    STATES,
    Assumptions,
    State,
    arrived,
    elements,
    move,
    multiply,
    send,
    spread,
    start,
    state_of,
    supply_of,
)
from ehls_ros.physics import sensors
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.plant import PL, XV, X

LATER = 64
"""Readings after a cycle that are used for its force; the filter's slowest response has decayed long before."""

BLOCK = 64
"""Cycles that are smoothed together."""

READINGS = 4
"""Number of sensors read in each cycle."""

READ = 7
"""Entries in a row of readings."""

BRIDGED = 50
"""Most omitted cycles over which the filter is continued."""

INNOVATION = STATES
"""Index, after the gain, of a reading's innovation over its variance; NaN if there was no reading."""


class PreviewLaw(Protocol):
    """Interface of a law with preview."""

    def assumptions(self, state: State, activity: Array, p: Any, model: Model) -> Assumptions:
        """Return the filter's assumptions for the next cycle."""


class History(NamedTuple):
    """Last steps of the filter, in order from the end of the last block on.

    Attributes:
        steps: number of steps, shape (1,).
        transitions: transition of the model over the cycle before, shape (n, STATES, STATES).
        readings: gain and innovation of each reading, shape (n, READINGS, STATES + 1).
        forces: filtered external force, shape (n,) [N].
        rows: row of the external force in the covariance, shape (n, STATES).
        memory: memory of the filter and the activity of the external force.
        work: scratch, shape (2, STATES, STATES).
    """

    steps: Array
    transitions: Array
    readings: Array
    forces: Array
    rows: Array
    memory: Array
    work: Array


def history() -> History:
    """Return a history without readings."""
    steps = BLOCK + LATER
    return History(
        np.zeros(1),
        np.zeros((steps, STATES, STATES)),
        np.zeros((steps, READINGS, STATES + 1)),
        np.zeros(steps),
        np.zeros((steps, STATES)),
        np.zeros(state_estimator.MEMORY_SIZE + process_noise.SIZE),
        np.zeros((2, STATES, STATES)),
    )


@separate_kernel
def _advance(supply: float, model: Model, p: Assumptions, state: State, transition: Array, product: Array) -> None:
    """Advance the filter by a period as :func:`ehls_ros.control.state_estimator.advance` does, and write the transition."""
    transition[:] = 0.0
    for i in range(STATES):
        transition[i, i] = 1.0
    for i in range(len(state.ages)):
        state.ages[i] += model.period
    t = -model.period
    while t < -ROUNDING:
        command, until = arrived(t, p.command_delay, state)
        duration = min(until, 0.0, t + MAX_COVARIANCE_STEP) - t
        spread(state, command, supply, duration, model, p)
        multiply(state.matrices[1], transition, product)
        for i in range(len(product)):
            copy(product[i], transition[i])
        move(state.mean, state.mode, command, supply, duration, model, p, state.work)
        t += duration


@separate_kernel
def _read(reading: float, signal: int, scale: float, offset: float, noise: float, state: State, kept: Array) -> None:
    """Process one reading as :func:`ehls_ros.control.state_estimator.correct` does, and write gain and innovation."""
    missed = reading - scale * state.mean[signal] - offset * state.mean[CELL_OFFSET]
    if not math.isfinite(missed):
        kept[INNOVATION] = math.nan
        return
    state_estimator.correct(reading, signal, scale, offset, noise, state)
    variance = scale * state.gain[signal] + offset * state.gain[CELL_OFFSET] + noise * noise
    for i in range(STATES):
        kept[i] = state.gain[i] / variance
    kept[INNOVATION] = missed / variance


@kernel
def _back(signal: int, scale: float, offset: float, kept: Array, adjoint: Array) -> None:
    """Propagate the adjoint backwards through one reading."""
    if math.isnan(kept[INNOVATION]):
        return
    total = kept[INNOVATION]
    for i in range(STATES):
        total += kept[i] * adjoint[i]
    adjoint[signal] -= scale * total
    adjoint[CELL_OFFSET] -= offset * total


@separate_kernel
def smooth(history: History, area: float, found: Array) -> None:
    """Write the smoothed force of the block, and drop the block.

    Args:
        history: full history.
        area: piston area [m^2].
        found: output, shape (BLOCK,) [N].
    """
    steps = BLOCK + LATER
    adjoint, turned = history.work[0, 0], history.work[0, 1]
    adjoint[:] = 0.0
    for k in range(steps - 1, -1, -1):
        if k < BLOCK:
            total = history.forces[k]
            for i in range(STATES):
                total -= history.rows[k, i] * adjoint[i]
            found[k] = total
        _back(XV, 1.0, 0.0, history.readings[k, 3], adjoint)
        _back(PL, area, 1.0, history.readings[k, 2], adjoint)
        _back(PL, 1.0, 0.0, history.readings[k, 1], adjoint)
        _back(X, 1.0, 0.0, history.readings[k, 0], adjoint)
        for i in range(STATES):
            turned[i] = 0.0
        for j in range(STATES):
            for i in range(STATES):
                turned[i] += history.transitions[k, j, i] * adjoint[j]
        copy(turned, adjoint)
    for k in range(LATER):
        for i in range(STATES):
            copy(history.transitions[BLOCK + k, i], history.transitions[k, i])
        for i in range(READINGS):
            copy(history.readings[BLOCK + k, i], history.readings[k, i])
        history.forces[k] = history.forces[BLOCK + k]
        copy(history.rows[BLOCK + k], history.rows[k])
    history.steps[0] = LATER


class Compiled(NamedTuple):
    """The compiled entry.

    Attributes:
        take: processes contiguous cycles, and returns the number of smoothed forces written.
    """

    take: Callable[..., int]


def build(law: PreviewLaw) -> Compiled:
    """Build the smoother of a law."""
    assumptions = law.assumptions

    @kernel
    def take(measured: Array, command: Array, tuning: Any, model: Model, history: History, found: Array, now: Array) -> int:
        done, n = 0, 0
        state = state_of(history.memory)
        for k in range(len(command)):
            m = measured[k]
            taken = assumptions(state, history.memory[state_estimator.MEMORY_SIZE :], tuning, model)
            if state.started[0] == 0.0:
                if math.isfinite(m[sensors.POSITION] + m[sensors.LOAD_PRESSURE] + m[sensors.SPOOL]):
                    start(m, model, taken, state)
                    # The whole force is learnt, as a foreseen one includes the yielding of the actuator under test.
                    state.expected[3] = 1.0
                    n = 0
                    history.transitions[n] = 0.0
                    history.readings[n, :, INNOVATION] = math.nan
                else:
                    continue
            else:
                n = int(history.steps[0])
                _advance(supply_of(m, model), model, taken, state, history.transitions[n], history.work[1])
                position = state.mean[X]
                kept = history.readings[n]
                _read(m[sensors.POSITION], X, 1.0, 0.0, taken.position_noise, state, kept[0])
                _read(m[sensors.LOAD_PRESSURE], PL, 1.0, 0.0, taken.pressure_noise, state, kept[1])
                _read(m[sensors.FORCE], PL, model.plant.piston_area, 1.0, taken.force_noise, state, kept[2])
                _read(m[sensors.SPOOL], XV, 1.0, 0.0, taken.spool_noise, state, kept[3])
                for i in range(elements(model.friction)):
                    if state.mode[i] == 0.0:
                        state.mean[STATES + i] += model.friction.element_stiffness[i] * (state.mean[X] - position)
            send(command[k], state)
            history.forces[n] = now[k] = state.mean[EXTERNAL]
            copy(state.covariance[EXTERNAL], history.rows[n])
            history.steps[0] = n + 1.0
            if n + 1 == BLOCK + LATER:
                smooth(history, model.plant.piston_area, found[done : done + BLOCK])
                done += BLOCK
        return done

    return Compiled(take)


class Forces(NamedTuple):
    """External forces of contiguous cycles.

    Attributes:
        now: filtered forces of the processed cycles, NaN before the first reading, shape (n,) [N].
        first: number of the first newly smoothed cycle.
        smoothed: smoothed forces from that cycle on [N].
    """

    now: Array
    first: int
    smoothed: Array


class Smoother:
    """Run filter and smoother."""

    def __init__(self, law: PreviewLaw, tuning: Any, model: Model) -> None:
        """Prepare filter and smoother.

        Args:
            law: file of the controller.
            tuning: parameters of the controller.
            model: its model of the rig.
        """
        self._tuning = tuning
        entries = {"take": "measured, command, tuning, model, history, found, now"}
        self._take = compiled(build, entries, {"law": law}).take
        self._found = np.empty(BLOCK)
        self._next = -1
        self._last = 0.0
        self._model = model
        self.reset()

    def prepare(self) -> None:
        """Compile or load the filter by a call without cycles."""
        nothing = np.empty(0)
        self._take(np.empty((0, READ)), nothing, self._tuning, self._model, self._history, self._found, nothing)

    def reset(self) -> None:
        """Reset the filter, if the valve does not follow the commands or cycles are missing."""
        self._history = history()

    def take(self, first: int, measured: Array, command: Array, model: Model) -> Forces:
        """Process contiguous cycles.

        Over a few omitted cycles before them the valve is assumed to have held its command.

        Args:
            first: number of the first cycle.
            measured: readings in the order of ``SENSED``, shape (n, 7).
            command: spool commands [m], shape (n,).
            model: the law's model of the rig.
        """
        left_out = first - self._next
        if not 0 <= left_out <= BRIDGED:
            self.reset()
            left_out = 0
        if left_out > 0:
            measured = np.concatenate([np.full((left_out, measured.shape[1]), np.nan), measured])
            command = np.concatenate([np.full(left_out, self._last), command])
        self._next, self._last = first + len(command) - left_out, float(command[-1])
        room = len(command) + BLOCK
        if len(self._found) < room:
            self._found = np.empty(room)
        now = np.full(len(command), np.nan)
        measured, command = np.ascontiguousarray(measured), np.ascontiguousarray(command)
        done = self._take(measured, command, self._tuning, model, self._history, self._found, now)
        oldest = self._next - int(self._history.steps[0])
        if not math.isfinite(self._history.memory.sum()):
            # Like the law's filter, it does not recover from numbers out of range.
            self.reset()
        return Forces(now[left_out:], oldest - done, self._found[:done].copy())
