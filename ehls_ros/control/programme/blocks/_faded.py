"""Fade a signal in from a rest value and back to it."""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references._blend import quintic


def faded(rows: Array, t: Array, rest: float, duration: float, fade: float) -> Array:
    """Return a signal faded in and out about a value, with its derivatives.

    Args:
        rows: the signal with its first and second derivative, shape (n, 3).
        t: times since the beginning, shape (n,) [s].
        rest: value at the beginning and at the end.
        duration: time until the end [s].
        fade: time of each of the two fades [s].
    """
    up, up_rate, up_bend = quintic(t, fade)
    down, down_rate, down_bend = quintic(duration - t, fade)
    weight, rate = up * down, up_rate * down - up * down_rate
    bend = up_bend * down - 2.0 * up_rate * down_rate + up * down_bend
    apart = rows[:, 0] - rest
    return np.column_stack(
        [
            rest + weight * apart,
            rate * apart + weight * rows[:, 1],
            bend * apart + 2.0 * rate * rows[:, 1] + weight * rows[:, 2],
        ]
    )
