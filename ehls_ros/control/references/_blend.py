"""A way from one value to another without a jump up to the second derivative."""

import numpy as np

from ehls_ros.arrays import Array


def quintic(since: Array, duration: float) -> tuple[Array, Array, Array]:
    """Return the quintic from rest at 0 to rest at 1, held before and after, with its derivatives.

    Args:
        since: times since it starts, shape (n,) [s].
        duration: time it takes [s].

    Returns:
        Value [1], first [1/s] and second derivative [1/s^2], shape (n,) each.
    """
    x = np.clip(since / duration, 0.0, 1.0)
    left = 1.0 - x
    value = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return value, 30.0 * (x * left) ** 2 / duration, 60.0 * x * left * (1.0 - 2.0 * x) / duration**2
