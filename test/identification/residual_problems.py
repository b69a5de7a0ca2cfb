"""Sums of squares with known minima, compiled, for the optimisers to solve."""

import math
from typing import Any

import numpy as np
from numba import njit

from ehls_ros.identification.optimisers.base import Problem


@njit(error_model="numpy")
def bowl(x: Any, data: Any, out: Any) -> None:
    """A convex quadratic about a centre; records the range of the points evaluated."""
    scale, centre, smallest, largest = data
    for j in range(x.size):
        out[j] = scale[j] * (x[j] - centre[j])
        smallest[j] = min(smallest[j], x[j])
        largest[j] = max(largest[j], x[j])


@njit(error_model="numpy")
def rosenbrock(x: Any, data: Any, out: Any) -> None:
    """Rosenbrock's valley, minimum 0 at 1."""
    (steepness,) = data
    for j in range(x.size - 1):
        out[2 * j] = steepness * (x[j + 1] - x[j] ** 2)
        out[2 * j + 1] = 1.0 - x[j]


@njit(error_model="numpy")
def holed(x: Any, data: Any, out: Any) -> None:
    """A bowl that is undefined left of an edge."""
    centre, edge = data
    for j in range(x.size):
        out[j] = x[j] - centre[j] if x[0] > edge else math.nan


def bowl_problem(centre: tuple[float, ...]) -> Problem:
    """A bowl in the box from -5 to 5, ten times steeper from each axis to the next."""
    middle = np.array(centre)
    data = (10.0 ** np.arange(len(centre)), middle, np.full(len(centre), np.inf), np.full(len(centre), -np.inf))
    return Problem(bowl, data, len(centre), np.full(len(centre), -5.0), np.full(len(centre), 5.0), "bowl")


def rosenbrock_problem(size: int = 2) -> Problem:
    """The valley in a box not centred on its minimum."""
    return Problem(rosenbrock, (10.0,), 2 * (size - 1), np.full(size, -3.0), np.full(size, 4.0), "rosenbrock")


def holed_problem(edge: float) -> Problem:
    """The bowl with a hole, in the box from -1 to 1; the minimum is at 0.5 if the edge leaves it."""
    return Problem(holed, (np.array([0.5, 0.5]), edge), 2, np.full(2, -1.0), np.full(2, 1.0), "holed")
