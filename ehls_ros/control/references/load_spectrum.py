"""A recorded load spectrum: points of time and value, joined by a quintic spline."""

from typing import Annotated, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.schema import text

DEGREE = 5
"""Its second derivative is smooth, as the sliding mode law needs it."""


class Parameters(NamedTuple):
    """The points; a spec names a CSV ``file`` with the columns time_s and value in their place."""

    points: Annotated[tuple[tuple[float, float], ...], text("time [s] and value [N or m] of each point, in order of time")]


def sample(t: Array, p: Parameters) -> Array:
    """Return the spline and its derivatives; before the first and after the last point it holds their values.

    Raises:
        BadInput: fewer than two points, or times that do not increase.
    """
    points = np.asarray(p.points, dtype=np.float64)
    if len(points) < 2 or not np.all(np.isfinite(points)) or not np.all(np.diff(points[:, 0]) > 0.0):
        raise BadInput(f"{len(points)} points", "reference: load_spectrum", "two or more finite points, time increasing")
    highest_odd = len(points) - 1 - len(points) % 2
    spline = make_interp_spline(points[:, 0], points[:, 1], k=min(DEGREE, highest_odd))
    inside = (t >= points[0, 0]) & (t <= points[-1, 0])
    held = np.clip(t, points[0, 0], points[-1, 0])
    out = np.column_stack([spline(held), spline(held, 1), spline(held, 2) if spline.k > 1 else np.zeros_like(t)])
    out[~inside, 1:] = 0.0
    return out
