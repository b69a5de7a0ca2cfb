"""A test programme: blocks of load cycles, ramps, dwells and recorded loads, with repeats; its final value is held."""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import programme_of

__all__ = ["Parameters", "duration", "place", "sample"]


def duration(p: Parameters) -> float:
    """Return the duration of the programme [s].

    Raises:
        BadInput: a block is wrong.
    """
    return programme_of(p).duration


def sample(t: Array, p: Parameters) -> Array:
    """Return the programme and its derivatives.

    Raises:
        BadInput: a block is wrong.
    """
    return programme_of(p).sample(t)


def place(t: Array, p: Parameters) -> Array:
    """Return block and load cycles completed in its present pass, shape (n, 2), NaN if nothing repeats."""
    points = programme_of(p).points(t)
    return np.column_stack([points.block, points.repetition + points.phase])
