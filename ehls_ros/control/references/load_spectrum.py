"""A recorded load spectrum: points of time and value, joined by a quintic spline."""

from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.schema import text

DEGREE = 5
"""Degree of the spline, for a smooth second derivative as required by the sliding mode law."""

AT_REST = [(1, 0.0), (2, 0.0)]
"""Zero first and second derivative at both ends, so that the held values before and after join smoothly."""


class Parameters(NamedTuple):
    """The points; in place of them a spec may name a CSV ``file`` with the columns time_s and value."""

    points: Annotated[tuple[tuple[float, float], ...], text("time [s] and value [N or m] of each point, in order of time")]


@lru_cache(maxsize=4)
def _spline(p: Parameters) -> "scipy.interpolate.BSpline":
    """Return the spline through the points; cached, as it is needed for every block of cycles."""
    points = np.asarray(p.points, dtype=np.float64)
    if len(points) < 2:
        raise BadInput(f"points holds {len(points)}", "load_spectrum", "two or more points")
    for index, (time, value) in enumerate(points):
        if not (np.isfinite(time) and np.isfinite(value)):
            raise BadInput(f"points[{index}] is {time:g}, {value:g}", "load_spectrum", "finite numbers")
        if index and time <= points[index - 1, 0]:
            raise BadInput(
                f"points[{index}] is at {time:g} s after {points[index - 1, 0]:g} s", "load_spectrum", "increasing times"
            )
    return scipy.interpolate.make_interp_spline(points[:, 0], points[:, 1], k=DEGREE, bc_type=(AT_REST, AT_REST))


def sample(t: Array, p: Parameters) -> Array:
    """Return the spline and its derivatives; the values of the first and the last point are held outside.

    Raises:
        BadInput: there are fewer than two points, or times that do not increase.
    """
    spline = _spline(p)
    first, last = p.points[0][0], p.points[-1][0]
    inside = (t >= first) & (t <= last)
    held = np.clip(t, first, last)
    out = np.column_stack([spline(held), spline(held, 1), spline(held, 2)])
    out[~inside, 1:] = 0.0
    return out
