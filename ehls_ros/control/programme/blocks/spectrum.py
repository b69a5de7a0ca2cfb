"""Block with a recorded load, as in the reference `load_spectrum`; one pass is a load cycle."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.control.references import load_spectrum, ramp
from ehls_ros.schema import quantity, text


class Parameters(NamedTuple):
    """Points, and the number of passes; instead of points a programme may name a CSV ``file``."""

    points: Annotated[tuple[tuple[float, float], ...], text("time [s] and value [N or m] of each point, in order of time")]
    count: Annotated[int, quantity("1", "number of passes", minimum=1, maximum=10**12)] = 1  # type: ignore[assignment]  # a tuple has a method of this name
    scale: Annotated[float, quantity("1", "factor to the values", minimum=-1e6, maximum=1e6)] = 1.0
    closing: Annotated[
        float, quantity("s", "time of the ramp back to the first value, where the last one is another", above=0.0, maximum=1e4)
    ] = 0.5


def _times(p: Parameters) -> tuple[float, float]:
    """Return the duration of the points, and of a pass [s]."""
    (first, begin), (last, end) = p.points[0], p.points[-1]
    return last - first, last - first + (p.closing if begin != end else 0.0)


def course(p: Parameters, start: float) -> Course:
    """Return the course of the passes.

    Raises:
        BadInput: fewer than two points, or times that do not increase.
    """
    load_spectrum.sample(np.zeros(1), load_spectrum.Parameters(p.points))
    _, whole = _times(p)
    begin = p.scale * p.points[0][1]
    return Course(begin, begin, p.count * whole, whole, p.count, 0.01 * min(np.diff([time for time, _ in p.points])))


def sample(t: Array, p: Parameters, start: float) -> Array:
    """Return the passes and their derivatives; each ends with a ramp back to its initial value."""
    recorded, whole = _times(p)
    within = t - whole * np.clip(np.floor(t / whole + 1e-12), 0, p.count - 1)
    rows = load_spectrum.sample(p.points[0][0] + within, load_spectrum.Parameters(p.points))
    if whole > recorded:
        back = ramp.Parameters(p.points[-1][1], p.points[0][1], p.closing)
        rows = np.where((within > recorded)[:, np.newaxis], ramp.sample(within - recorded, back), rows)
    return p.scale * rows
