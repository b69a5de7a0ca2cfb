"""Position of a cyclic reference in its load cycles."""

import numpy as np

from ehls_ros.arrays import Array


def place_of(t: Array, frequency: float) -> Array:
    """Return block 0 and the load cycles completed with their fraction, shape (n, 2); NaN if nothing repeats.

    Args:
        t: times, shape (n,) [s].
        frequency: frequency of the load cycles [Hz].
    """
    cycles = t * frequency if frequency > 0.0 else np.full(t.shape, np.nan)
    return np.column_stack([np.zeros(t.shape), cycles])
