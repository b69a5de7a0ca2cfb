"""Fixed-step integration of switching systems: Runge-Kutta of order 4 or 2, with events located.

A system is two compiled functions over a time ``t``, a state ``y``, modes ``mode`` and whatever else
it needs in ``c``:

* ``evaluate(t, y, mode, c, rate)`` writes dy/dt, smooth as long as the modes stand, and returns the event
  function: positive once a mode has to change, and continuous before;
* ``switch(t, y, mode, c)`` changes the modes (and, in an impact, the state) there.

A step that would end past an event is shortened to end on it, so that a discontinuity never lies inside
a step and the order of the method holds through stick and slip. The evaluation that looks for an event at
the end of a step is the first stage of the next.
"""

from collections.abc import Callable
from typing import Any, Literal

from numba import njit

from ehls_ros.arrays import Array, lean

WORK_ROWS = 6
"""Rows of scratch that an integrator needs, each as long as the state."""

MOST_EVENTS = 16
"""Events located within one step; a system that switches more often is stepped over them."""

EVENT_TOLERANCE = 1e-9
"""How well an event is located, as a fraction of the step."""

MOST_ITERATIONS = 64
"""Enough to halve a step down to the tolerance at every second iteration."""


def integrator(
    evaluate: Callable[..., float],
    switch: Callable[..., None],
    size: int = 0,
    most_events: int = MOST_EVENTS,
    order: Literal[2, 4] = 4,
) -> Callable[..., int]:
    """Build the compiled integrator of one system.

    Args:
        evaluate: of the system.
        switch: of the system.
        size: length of the state where it is known beforehand: the compiler then unrolls the loops over it; 0: any.
        most_events: how many events to locate within a step; with 0, modes change at the ends of steps only.
        order: 4, the classical method; or 2, the midpoint rule, at half the cost a step.

    Returns:
        ``advance(t, y, mode, c, step, steps, work)``, see below.
    """

    @lean
    def runge_kutta(t: float, y: Array, mode: Array, c: Any, step: float, work: Array) -> None:
        """Take one classical Runge-Kutta step from ``y``, its rates in ``work[2]``, and leave the result in ``work[0]``."""
        n = size or y.size
        end, stage, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4], work[5]
        for i in range(n):
            stage[i] = y[i] + 0.5 * step * k1[i]
        evaluate(t + 0.5 * step, stage, mode, c, k2)
        for i in range(n):
            stage[i] = y[i] + 0.5 * step * k2[i]
        evaluate(t + 0.5 * step, stage, mode, c, k3)
        for i in range(n):
            stage[i] = y[i] + step * k3[i]
        evaluate(t + step, stage, mode, c, k4)
        for i in range(n):
            end[i] = y[i] + step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])

    @lean
    def midpoint(t: float, y: Array, mode: Array, c: Any, step: float, work: Array) -> None:
        """Take one step of the midpoint rule; arguments as of the classical method."""
        n = size or y.size
        end, stage, k1, k2 = work[0], work[1], work[2], work[3]
        for i in range(n):
            stage[i] = y[i] + 0.5 * step * k1[i]
        evaluate(t + 0.5 * step, stage, mode, c, k2)
        for i in range(n):
            end[i] = y[i] + step * k2[i]

    advanced = runge_kutta if order == 4 else midpoint

    # Rare and long: kept out of the loop it is called from.
    @njit(error_model="numpy")
    def locate(t: float, y: Array, mode: Array, c: Any, step: float, after: float, work: Array) -> float:
        """Find where in a step the event function crosses zero.

        Regula falsi in the Illinois variant; where it does not halve the bracket, as where the event function has
        been flat, a bisection follows.

        Args:
            t: time at the start of the step [s].
            y: state there.
            mode: modes during the step.
            c: coefficients of the system.
            step: length of the step [s]; the event lies inside.
            after: the event function at its end, positive.
            work: scratch; ``work[0]`` holds the state at the event when it returns.

        Returns:
            Time from ``t`` to just behind the event [s].
        """
        before = min(evaluate(t, y, mode, c, work[2]), 0.0)
        low, high = 0.0, step
        tolerance = EVENT_TOLERANCE * step
        side, halve = 0, False
        for left in range(MOST_ITERATIONS, -1, -1):
            width = high - low
            found = width <= tolerance or left == 0
            if found:
                middle = high
            elif halve:
                middle = low + 0.5 * width
            else:
                # Half a tolerance behind the estimate, so that both ends of the bracket close in.
                middle = high - after * width / (after - before) + 0.5 * tolerance
                middle = min(max(middle, low + 0.25 * tolerance), high - 0.25 * tolerance)
            advanced(t, y, mode, c, middle, work)
            if found:
                break
            value = evaluate(t + middle, work[0], mode, c, work[1])
            if value > 0.0:
                high, after = middle, value
                before *= 0.5 if side == 1 else 1.0
                side = 1
            else:
                low, before = middle, value
                after *= 0.5 if side == -1 else 1.0
                side = -1
            halve = high - low > 0.5 * width
        return high

    @lean
    def advance(t: float, y: Array, mode: Array, c: Any, step: float, steps: int, work: Array) -> int:
        """Advance the system by a number of fixed steps.

        Args:
            t: time at the start [s].
            y: state, advanced in place.
            mode: modes, changed in place.
            c: coefficients of the system.
            step: length of a step [s].
            steps: number of steps.
            work: scratch of shape (:data:`WORK_ROWS`, y.size).

        Returns:
            Number of steps in which events came too densely to be located; 0 is the rule.
        """
        dense = 0
        # Inputs may have jumped since the last call.
        changed = True
        for index in range(steps):
            now = t + index * step
            remaining = step
            located = 0
            while remaining > EVENT_TOLERANCE * step:
                if changed and evaluate(now, y, mode, c, work[2]) > 0.0:
                    switch(now, y, mode, c)
                    evaluate(now, y, mode, c, work[2])
                advanced(now, y, mode, c, remaining, work)
                taken = remaining
                after = evaluate(now + remaining, work[0], mode, c, work[2])
                changed = after > 0.0
                if changed and located < most_events:
                    taken = locate(now, y, mode, c, remaining, after, work)
                    located += 1
                elif changed:
                    dense += 1
                for i in range(size or y.size):
                    y[i] = work[0, i]
                now += taken
                remaining -= taken
        return dense

    return advance
