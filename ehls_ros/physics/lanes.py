"""Integrator for lanes: step many trajectories of one system together.

The step is that of :mod:`ehls_ros.physics.integration`, compiled into a loop over the lanes. A lane whose event function turns
positive repeats the step separately, from its start and with events located. Thus each lane gives bitwise the same numbers as
alone.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from numba import njit

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.physics.integration import MAX_EVENTS, STEP_ROWS, steps_of
from ehls_ros.physics.lane_memory import LANES, Rows, column, stack, wide_vectors

RATE = 2
"""Row of the integrator's workspace with the rates: at the start of a step before it, at the end after it."""


class LaneRows(NamedTuple):
    """First rows of the integrator's data in a block.

    Attributes:
        mode: modes.
        y: state.
        rate: rates at the start of the next step.
        changed: event function at the start of the next step, positive where a mode must change.
        end: state after the step.
        end_rate: rates after the step.
        after: event function after the step.
    """

    mode: int
    y: int
    rate: int
    changed: int
    end: int
    end_rate: int
    after: int

    @classmethod
    def of(cls, rows: Rows, size: int, modes: int) -> "LaneRows":
        """Allocate the rows for a number of states and modes."""
        return cls(*(rows.take(n) for n in (modes, size, size, 1, size, size, 1)))


def lanes_integrator(
    evaluate: Callable[..., float],
    switch: Callable[..., None],
    coefficients: Callable[..., Any],
    rows: LaneRows,
    size: int,
    modes: int,
    most_events: int = MAX_EVENTS,
    order: Literal[2, 4, 5] = 4,
) -> Callable[..., int]:
    """Build the compiled integrator of a block of lanes.

    Args:
        evaluate: rates and event function of the system.
        switch: mode changes of the system.
        coefficients: compiled ``coefficients(block, like, lane)``, which returns ``c`` of a lane; ``like`` provides its
            types.
        rows: rows of state and modes in the block.
        size: length of the state.
        modes: number of modes.
        most_events: see :func:`~ehls_ros.physics.integration.integrator`.
        order: see :func:`~ehls_ros.physics.integration.integrator`.

    Returns:
        ``advance(t, block, like, step, steps, work)``, which advances every lane as that of
        :func:`~ehls_ros.physics.integration.integrator` advances one system.
    """
    take_step, located_step = steps_of(evaluate, switch, size, most_events, order)
    w0, w1, w2, w3, w4, w5, w6, w7 = (stack(size) for _ in range(STEP_ROWS))
    states, modes_of = column(size), column(modes)
    MODE, Y, RATE_ROW, CHANGED, END, END_RATE, AFTER = rows
    carried = 2 * size + 1

    @kernel_no_refcount
    def copy(source: Array, target: Array) -> None:
        for i in range(size):
            target[i] = source[i]

    @kernel_no_refcount
    def evaluate_all(t: float, block: Array, like: Any) -> None:
        """Evaluate all lanes at the start, as inputs may have jumped."""
        for lane in range(LANES):
            y, rate, mode = w0(), w2(), modes_of(block, MODE, lane)
            copy(states(block, Y, lane), y)
            block[CHANGED * LANES + lane] = evaluate(t, y, mode, coefficients(block, like, lane), rate)
            copy(rate, states(block, RATE_ROW, lane))

    @kernel_no_refcount
    def step_all(t: float, block: Array, like: Any, step: float) -> None:
        """Step all lanes without event location."""
        for lane in range(LANES):
            work = (w0(), w1(), w2(), w3(), w4(), w5(), w6(), w7())
            mode, c = modes_of(block, MODE, lane), coefficients(block, like, lane)
            copy(states(block, RATE_ROW, lane), work[RATE])
            take_step(t, states(block, Y, lane), mode, c, step, work)
            block[AFTER * LANES + lane] = evaluate(t + step, work[0], mode, c, work[RATE])
            copy(work[0], states(block, END, lane))
            copy(work[RATE], states(block, END_RATE, lane))

    @njit(error_model="numpy", forceinline=False)
    def step_one(t: float, block: Array, like: Any, step: float, lane: int, work: Array) -> int:
        """Step one lane with event location."""
        y, mode = w0(), modes_of(block, MODE, lane)
        copy(states(block, Y, lane), y)
        copy(states(block, RATE_ROW, lane), work[RATE])
        due = block[CHANGED * LANES + lane] > 0.0
        changed, dense = located_step(t, y, mode, coefficients(block, like, lane), step, due, work)
        copy(y, states(block, END, lane))
        copy(work[RATE], states(block, END_RATE, lane))
        block[AFTER * LANES + lane] = 1.0 if changed else 0.0
        return dense

    @njit(error_model="numpy", forceinline=False)
    def advance(t: float, block: Array, like: Any, step: float, steps: int, work: Array) -> int:
        """Advance all lanes.

        Args:
            t: time at the start [s].
            block: the lanes.
            like: see ``coefficients``.
            step: length of a step [s].
            steps: number of steps.
            work: workspace of one lane, shape (:data:`~ehls_ros.physics.integration.WORK_ROWS`, size).

        Returns:
            Number of steps with more events than were located, summed over all lanes.
        """
        wide_vectors()
        dense = 0
        evaluate_all(t, block, like)
        for index in range(steps):
            now = t + index * step
            step_all(now, block, like, step)
            due = 0
            for lane in range(LANES):
                due += block[CHANGED * LANES + lane] > 0.0 or block[AFTER * LANES + lane] > 0.0
            if due > 0:
                for lane in range(LANES):
                    if block[CHANGED * LANES + lane] > 0.0 or block[AFTER * LANES + lane] > 0.0:
                        dense += step_one(now, block, like, step, lane, work)
            for i in range(carried * LANES):
                block[Y * LANES + i] = block[END * LANES + i]
        return dense

    return advance
