"""Block that holds the programme's present value."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Duration of the dwell."""

    time: Annotated[float, quantity("s", "time for which the value is held", above=0.0, maximum=1e7)]


def course(p: Parameters, start: float) -> Course:
    """Return the course of the dwell."""
    return Course(start, start, p.time, 0.0, 0, p.time)


def sample(t: Array, p: Parameters, start: float) -> Array:
    """Return the held value with zero derivatives."""
    out = np.zeros((t.size, 3))
    out[:, 0] = start
    return out
