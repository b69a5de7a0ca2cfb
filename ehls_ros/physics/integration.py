"""Fixed-step integration of hybrid systems: Runge-Kutta of order 2, 4 or 5 with event location.

A system is two compiled functions of time ``t``, state ``y``, modes ``mode`` and coefficients ``c``:

* ``evaluate(t, y, mode, c, rate)`` writes dy/dt, smooth while the modes are constant, and returns the event function,
  continuous up to an event and positive once a mode must change;
* ``switch(t, y, mode, c)`` changes the modes (and, at an impact, the state) at the event.

A step that would pass an event is shortened to end on it. No step contains a discontinuity, so the order of the method is kept
through stick and slip. The evaluation that checks for an event at the end of a step is also the first stage of the next step.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from ehls_ros.arrays import Array, kernel_no_refcount, separate_kernel
from ehls_ros.duals import as_element, length_to_event, varies

STEP_ROWS = 8
"""Rows of workspace per step, each as long as the state."""

WORK_ROWS = STEP_ROWS + 1
"""Rows of an integrator's workspace; the last row holds the state after an event that is not yet bracketed."""

MAX_EVENTS = 16
"""Most events located within one step; further ones are not located."""

EVENT_TOLERANCE = 1e-9
"""Tolerance of the event time, as a fraction of the step."""

HALVINGS = 18
"""Bisections of a step to predict an event. Each costs one evaluation; later iterations cost a whole step."""

SLOW = 3
"""Consecutive iterations that do not halve the bracket, after which it is bisected."""

MAX_ITERATIONS = 128
"""Enough iterations to bisect a step down to the tolerance at every fourth one."""


class Steps(NamedTuple):
    """Compiled steps of one system.

    Attributes:
        take: ``take(t, y, mode, c, step, work)`` takes one Runge-Kutta step from ``y`` at constant modes, with its rates in
            ``work[2]``; the result is in ``work[0]``.
        located: ``located(t, y, mode, c, step, changed, work) -> changed, dense`` takes one step and locates the events in it.
            ``changed`` is whether the rates in ``work[2]`` may be out of date and a mode may have to change; ``dense`` is 1 if
            the step has more events than were located.
    """

    take: Callable[..., None]
    located: Callable[..., tuple[bool, int]]


def steps_of(
    evaluate: Callable[..., float],
    switch: Callable[..., None],
    size: int = 0,
    most_events: int = MAX_EVENTS,
    order: Literal[2, 4, 5] = 4,
) -> Steps:
    """Build the compiled steps of one system; the arguments are those of :func:`integrator`."""

    @kernel_no_refcount
    def runge_kutta(t: float, y: Array, mode: Array, c: Any, step: float, work: Array) -> None:
        """Take one classical Runge-Kutta step from ``y``, with its rates in ``work[2]``; the result is in ``work[0]``."""
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

    @kernel_no_refcount
    def midpoint(t: float, y: Array, mode: Array, c: Any, step: float, work: Array) -> None:
        """Take one step of the midpoint rule; same arguments as ``runge_kutta``."""
        n = size or y.size
        end, stage, k1, k2 = work[0], work[1], work[2], work[3]
        for i in range(n):
            stage[i] = y[i] + 0.5 * step * k1[i]
        evaluate(t + 0.5 * step, stage, mode, c, k2)
        for i in range(n):
            end[i] = y[i] + step * k2[i]

    @kernel_no_refcount
    def dormand_prince(t: float, y: Array, mode: Array, c: Any, step: float, work: Array) -> None:
        """Take one step of the fifth-order formula of Dormand and Prince; same arguments as ``runge_kutta``."""
        n = size or y.size
        end, stage, k1, k2, k3, k4, k5, k6 = work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7]
        for i in range(n):
            stage[i] = y[i] + step * (1 / 5 * k1[i])
        evaluate(t + 1 / 5 * step, stage, mode, c, k2)
        for i in range(n):
            stage[i] = y[i] + step * (3 / 40 * k1[i] + 9 / 40 * k2[i])
        evaluate(t + 3 / 10 * step, stage, mode, c, k3)
        for i in range(n):
            stage[i] = y[i] + step * (44 / 45 * k1[i] - 56 / 15 * k2[i] + 32 / 9 * k3[i])
        evaluate(t + 4 / 5 * step, stage, mode, c, k4)
        for i in range(n):
            stage[i] = y[i] + step * (19372 / 6561 * k1[i] - 25360 / 2187 * k2[i] + 64448 / 6561 * k3[i] - 212 / 729 * k4[i])
        evaluate(t + 8 / 9 * step, stage, mode, c, k5)
        for i in range(n):
            stage[i] = y[i] + step * (
                9017 / 3168 * k1[i] - 355 / 33 * k2[i] + 46732 / 5247 * k3[i] + 49 / 176 * k4[i] - 5103 / 18656 * k5[i]
            )
        evaluate(t + step, stage, mode, c, k6)
        for i in range(n):
            end[i] = y[i] + step * (
                35 / 384 * k1[i] + 500 / 1113 * k3[i] + 125 / 192 * k4[i] - 2187 / 6784 * k5[i] + 11 / 84 * k6[i]
            )

    take_step = {2: midpoint, 4: runge_kutta, 5: dormand_prince}[order]

    @kernel_no_refcount
    def foresee(t: float, y: Array, mode: Array, c: Any, step: float, work: Array) -> float:
        """Predict the event in a step from the cubic interpolant of both end states and rates.

        Bisection needs only the sign of the event function. This function is the largest of several conditions in different
        units, so it has a kink where the largest condition changes.

        Args:
            t: time at the start of the step [s].
            y: state at the start of the step.
            mode: modes during the step.
            c: coefficients of the system.
            step: length of the step [s].
            work: workspace with the state at the end of the step in ``work[0]``, its rates in ``work[3]``, and those at the
                start in ``work[2]``.

        Returns:
            Time from ``t`` [s].
        """
        end, between, start_rate, end_rate = work[0], work[1], work[2], work[3]
        early, late = 0.0, 1.0
        for _ in range(HALVINGS):
            s = 0.5 * (early + late)
            for i in range(size or y.size):
                outer, rise = y[i] + s * s * (3.0 - 2.0 * s) * (end[i] - y[i]), s * (1.0 - s) * step
                between[i] = outer + rise * ((1.0 - s) * start_rate[i] - s * end_rate[i])
            if evaluate(t + s * step, between, mode, c, work[4]) > 0.0:
                late = s
            else:
                early = s
        return late * step

    @separate_kernel
    def locate(t: float, y: Array, mode: Array, c: Any, step: float, after: float, work: Array) -> float:
        """Locate the zero crossing of the event function in a step.

        Two trials bracket the predicted event. Regula falsi in the Illinois variant follows; where it converges slowly, as with
        a flat event function, the bracket is bisected.

        Args:
            t: time at the start of the step [s].
            y: state at the start of the step.
            mode: modes during the step.
            c: coefficients of the system.
            step: length of the step [s], which contains the event.
            after: event function at the end of the step, positive.
            work: workspace with the state at the end of the step in ``work[0]`` and its rates in ``work[2]``; on return
                ``work[0]`` holds the state at the event.

        Returns:
            Time from ``t`` to just after the event [s].
        """
        end, past = work[0], work[STEP_ROWS]
        for i in range(size or y.size):
            past[i] = end[i]
            work[3, i] = work[2, i]
        before = min(evaluate(t, y, mode, c, work[2]), 0.0)
        foreseen, error = foresee(t, y, mode, c, step, work), 0.5**HALVINGS * step
        low, high = 0.0, step
        tolerance = EVENT_TOLERANCE * step
        side = slow = 0
        for iteration in range(MAX_ITERATIONS):
            width = high - low
            if width <= tolerance:
                break
            if iteration < 2:
                middle = foreseen + (error if iteration == 0 else -2.0 * error)
            elif slow == SLOW:
                middle = low + 0.5 * width
                slow = 0
            else:
                middle = high - after * width / (after - before)
            # Next to an end that nearly coincides with the event, a step of almost the tolerance closes the bracket.
            middle = min(max(middle, low + 0.75 * tolerance), high - 0.75 * tolerance)
            take_step(t, y, mode, c, middle, work)
            value = evaluate(t + middle, end, mode, c, work[1])
            if value > 0.0:
                for i in range(size or y.size):
                    past[i] = end[i]
                high, after = middle, value
                before *= 0.5 if side == 1 else 1.0
                side = 1
            else:
                low, before = middle, value
                after *= 0.5 if side == -1 else 1.0
                side = -1
            slow = slow + 1 if high - low > 0.5 * width else 0
        for i in range(size or y.size):
            end[i] = past[i]
        return length_to_event(take_step, evaluate, t, y, mode, c, high, work)

    @kernel_no_refcount
    def located_step(t: float, y: Array, mode: Array, c: Any, step: float, changed: bool, work: Array) -> tuple[bool, int]:
        now, remaining = t, step
        located = dense = 0
        while remaining > EVENT_TOLERANCE * step or varies(remaining):
            if changed and evaluate(now, y, mode, c, work[2]) > 0.0:
                switch(now, y, mode, c)
                evaluate(now, y, mode, c, work[2])
            take_step(now, y, mode, c, remaining, work)
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
        return changed, dense

    return Steps(take_step, located_step)


def integrator(
    evaluate: Callable[..., float],
    switch: Callable[..., None],
    size: int = 0,
    most_events: int = MAX_EVENTS,
    order: Literal[2, 4, 5] = 4,
) -> Callable[..., int]:
    """Build the compiled integrator of one system.

    Args:
        evaluate: rates and event function of the system.
        switch: mode changes of the system.
        size: length of the state if known, so that the compiler unrolls the loops over it; 0 for any length.
        most_events: most events located within a step; with 0, modes change only at the ends of steps.
        order: 2 for the midpoint rule; 4 for the classical method; 5 for that of Dormand and Prince (1980), which takes six
            evaluations per step instead of four, but fewer steps for the same error.

    Returns:
        ``advance(t, y, mode, c, step, steps, work)``, see below.
    """
    located_step = steps_of(evaluate, switch, size, most_events, order).located

    @kernel_no_refcount
    def advance(t: float, y: Array, mode: Array, c: Any, step: float, steps: int, work: Array) -> int:
        """Advance the system by a number of fixed steps.

        Args:
            t: time at the start [s].
            y: state, updated in place.
            mode: modes, updated in place.
            c: coefficients of the system.
            step: length of a step [s].
            steps: number of steps.
            work: workspace, shape (:data:`WORK_ROWS`, y.size).

        Returns:
            Number of steps with more events than were located, normally 0.
        """
        dense = 0
        t, step = as_element(y, t), as_element(y, step)
        # Inputs may have jumped since the last call. A constant would let numba compile a step for it as well.
        changed = steps > 0
        for index in range(steps):
            changed, more = located_step(t + index * step, y, mode, c, step, changed, work)
            dense += more
        return dense

    return advance
