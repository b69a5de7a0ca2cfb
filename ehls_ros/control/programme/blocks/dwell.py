"""A dwell: the programme stays where it stands."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Its time."""

    time: Annotated[float, quantity("s", "time for which the value is held", above=0.0, maximum=1e7)]


def course(p: Parameters, start: float) -> Course:
    """Return how the dwell goes."""
    return Course(start, start, p.time, 0.0, 0, p.time)


def sample(t: Array, p: Parameters, start: float) -> Array:
    """Return the value held, and no change."""
    out = np.zeros((t.size, 3))
    out[:, 0] = start
    return out
