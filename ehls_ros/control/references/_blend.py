"""Transition from one value to another without a jump up to the second derivative."""

from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array


def quintic(since: Array, duration: float) -> tuple[Array, Array, Array]:
    """Return the quintic from rest at 0 to rest at 1, held before and after, with its derivatives.

    Args:
        since: times since its start, shape (n,) [s].
        duration: duration [s].

    Returns:
        Value [1], first [1/s] and second derivative [1/s^2], shape (n,) each.
    """
    x = np.clip(since / duration, 0.0, 1.0)
    left = 1.0 - x
    value = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return value, 30.0 * (x * left) ** 2 / duration, 60.0 * x * left * (1.0 - 2.0 * x) / duration**2


def eased_in(row: Sequence[float], start: float, since: float, duration: float) -> list[float]:
    """Return a reference's row, led in from rest at a value without a jump up to the second derivative.

    Args:
        row: value of the reference, first and second derivative.
        start: initial value, in the reference's unit.
        since: time since the beginning [s].
        duration: duration of the lead-in [s].
    """
    weight, rate, bend = (float(part[0]) for part in quintic(np.array([since]), duration))
    apart, speed, acceleration = row[0] - start, row[1], row[2]
    return [
        start + weight * apart,
        weight * speed + rate * apart,
        weight * acceleration + 2.0 * rate * speed + bend * apart,
    ]
