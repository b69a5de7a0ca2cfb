"""Levels held in sequence: a train of steps, a staircase, or moves with rests between them.

Transitions between levels follow a quintic, so that the second derivative does not jump. The last level is held.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references._signals import quintic
from ehls_ros.errors import BadInput
from ehls_ros.schema import quantity, text


class Parameters(NamedTuple):
    """The levels, starting from the first."""

    levels: Annotated[tuple[float, ...], text("levels in their order [N or m]")] = (0.0, 5e3, -5e3, 0.0)
    hold: Annotated[float, quantity("s", "time for which a level is held", minimum=0.0, maximum=1e4)] = 1.0
    rise: Annotated[float, quantity("s", "time from one level to the next", above=0.0, maximum=1e4)] = 0.5


def duration(p: Parameters) -> float:
    """Return the time until the last level has been held as long as the others [s]."""
    return len(p.levels) * p.hold + (len(p.levels) - 1) * p.rise


def sample(t: Array, p: Parameters) -> Array:
    """Return the levels and the transitions between them.

    Raises:
        BadInput: there is no level, or one that is not finite.
    """
    if not p.levels:
        raise BadInput("levels is empty", "steps", "one level or more")
    for index, level in enumerate(p.levels):
        if not math.isfinite(level):
            raise BadInput(f"levels[{index}] is {level:g}", "steps", "a finite number")
    whole = p.hold + p.rise
    before = np.clip(np.floor(t / whole), 0, len(p.levels) - 1).astype(np.intp)
    levels = np.asarray(p.levels)
    way = np.append(np.diff(levels), 0.0)[before]
    value, rate, acceleration = quintic(t - before * whole - p.hold, p.rise)
    return np.column_stack([levels[before] + way * value, way * rate, way * acceleration])
