"""Fixed-step integration of switching systems: classical Runge-Kutta of order 4, with events located.

A system is three compiled functions over a time ``t``, a state ``y``, modes ``mode`` and whatever else
it needs in ``c``:

* ``derivatives(t, y, mode, c, rate)`` writes dy/dt, smooth as long as the modes stand;
* ``event(t, y, mode, c)`` is positive once a mode has to change, and continuous before;
* ``switch(t, y, mode, c)`` changes the modes (and, in an impact, the state) there.

A step that would end past an event is shortened to end on it, so that a discontinuity never lies inside
a step and the order of the method holds through stick and slip.
"""

from collections.abc import Callable
from typing import Any

from numba import njit

from ehls_ros.arrays import Array, kernel

WORK_ROWS = 6
"""Rows of scratch that an integrator needs, each as long as the state."""

MOST_EVENTS = 16
"""Events located within one step; a system that switches more often is stepped over them."""

EVENT_TOLERANCE = 1e-9
"""How well an event is located, as a part of the step."""

MOST_ITERATIONS = 60


def integrator(
    derivatives: Callable[..., None], event: Callable[..., float], switch: Callable[..., None]
) -> Callable[..., int]:
    """Build the compiled integrator of one system.

    Args:
        derivatives: of the system.
        event: of the system.
        switch: of the system.

    Returns:
        ``advance(t, y, mode, c, step, steps, work)``, see below.
    """

    @kernel
    def runge_kutta(t: float, y: Array, mode: Array, c: Any, step: float, work: Array) -> None:
        """Take one classical Runge-Kutta step from ``y`` and leave the result in ``work[0]``."""
        n = y.size
        stage, k1, k2, k3, k4 = work[1], work[2], work[3], work[4], work[5]
        derivatives(t, y, mode, c, k1)
        for i in range(n):
            stage[i] = y[i] + 0.5 * step * k1[i]
        derivatives(t + 0.5 * step, stage, mode, c, k2)
        for i in range(n):
            stage[i] = y[i] + 0.5 * step * k2[i]
        derivatives(t + 0.5 * step, stage, mode, c, k3)
        for i in range(n):
            stage[i] = y[i] + step * k3[i]
        derivatives(t + step, stage, mode, c, k4)
        for i in range(n):
            work[0, i] = y[i] + step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


    # Rare and long: kept out of the loop it is called from.
    @njit(error_model="numpy")
    def locate(t: float, y: Array, mode: Array, c: Any, step: float, after: float, work: Array) -> float:
        """Find where in a step the event function crosses zero, by the Illinois variant of regula falsi.

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
        low, high = 0.0, step
        before = min(event(t, y, mode, c), 0.0)
        tolerance = EVENT_TOLERANCE * step
        side = 0
        for _ in range(MOST_ITERATIONS):
            if high - low <= tolerance:
                break
            # Half a tolerance behind the estimate, so that both ends of the bracket close in.
            middle = high - after * (high - low) / (after - before) + 0.5 * tolerance
            middle = min(max(middle, low + 0.25 * tolerance), high - 0.25 * tolerance)
            runge_kutta(t, y, mode, c, middle, work)
            value = event(t + middle, work[0], mode, c)
            if value > 0.0:
                high, after = middle, value
                if side == 1:
                    before *= 0.5
                side = 1
            else:
                low, before = middle, value
                if side == -1:
                    after *= 0.5
                side = -1
        runge_kutta(t, y, mode, c, high, work)
        return high


    @kernel
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
        if event(t, y, mode, c) > 0.0:
            switch(t, y, mode, c)
        for index in range(steps):
            now = t + index * step
            remaining = step
            located = 0
            while remaining > EVENT_TOLERANCE * step:
                runge_kutta(now, y, mode, c, remaining, work)
                taken = remaining
                after = event(now + remaining, work[0], mode, c)
                if after > 0.0 and located < MOST_EVENTS:
                    taken = locate(now, y, mode, c, remaining, after, work)
                    located += 1
                for i in range(y.size):
                    y[i] = work[0, i]
                now += taken
                remaining -= taken
                if after > 0.0:
                    switch(now, y, mode, c)
            dense += located == MOST_EVENTS
        return dense


    return advance
