"""Kernels of the optimisers: cost of a problem on the unit box, and search for its minimum.

All optimisers search the unit box, where u represents ``lower + u (upper - lower)``.
"""

import math
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import extending, njit

from ehls_ros.arrays import Array, kernel
from ehls_ros.errors import BadInput
from ehls_ros.identification.optimisers.base import Problem
from ehls_ros.physics import composition

STEP = 2.0**-26
"""Step of differences in the unit box: the root of a double's resolution."""


class Box(NamedTuple):
    """A problem as passed to its kernels.

    Attributes:
        data: data of the residual function.
        lower: lower bounds, shape (parameters,).
        upper: upper bounds, shape (parameters,).
    """

    data: Any
    lower: Array
    upper: Array


class Work(NamedTuple):
    """Scratch memory of a kernel, so that it allocates nothing.

    Attributes:
        x: a point of the problem's box, shape (parameters,).
        r: its residuals, shape (residual_count,).
        moved: a point of the unit box, shape (parameters,).
    """

    x: Array
    r: Array
    moved: Array


def box_of(problem: Problem) -> Box:
    """Return the box of a checked problem for the kernels."""
    return Box(problem.data, problem.lower, problem.upper)


def work_of(problem: Problem) -> Work:
    """Return scratch memory for a problem."""
    return Work(np.empty(problem.lower.size), np.empty(problem.residual_count), np.empty(problem.lower.size))


@njit(error_model="numpy", forceinline=True, fastmath={"contract", "reassoc"})
def half_square(r: Array) -> float:
    """Return half the sum of squares, added in the fastest order; infinity if it is not finite."""
    total = 0.0
    for k in range(r.size):
        total += r[k] * r[k]
    return min(math.inf, 0.5 * total)  # also where the total is NaN


@kernel
def place(u: Array, box: Box, x: Array) -> None:
    """Write the point of the problem's box represented by ``u`` into ``x``."""
    for j in range(u.size):
        # The sum could round to beyond the bound.
        x[j] = min(max(box.lower[j] + u[j] * (box.upper[j] - box.lower[j]), box.lower[j]), box.upper[j])


def cost(residuals: Any) -> Any:
    """Return the compiled cost at a point of the unit box, for a residual function."""

    @kernel
    def cost_at(u: Array, box: Box, work: Work) -> float:
        place(u, box, work.x)
        residuals(work.x, box.data, work.r)
        return half_square(work.r)

    return cost_at


def jacobian(residuals: Any) -> Any:
    """Return the compiled derivatives by the coordinates of the unit box, for a residual function.

    They are differences to a neighbouring point on the side farther from a bound. If the residuals there are not finite, the
    other side is used. If neither are finite, the derivatives are zero.
    """
    cost_at = cost(residuals)

    @kernel
    def derivatives(u: Array, r: Array, box: Box, work: Work, out: Array) -> None:
        moved, beside = work.moved, work.r
        for j in range(u.size):
            moved[j] = u[j]
        for j in range(u.size):
            step = STEP if u[j] < 0.5 else -STEP
            for _ in range(2):
                moved[j] = u[j] + step
                finite = cost_at(moved, box, work) < math.inf
                if finite:
                    break
                step = -step
            for k in range(r.size):
                out[k, j] = (beside[k] - r[k]) / (moved[j] - u[j]) if finite else 0.0
            moved[j] = u[j]

    return derivatives


@kernel
def within_spread(points: Array, spread: float) -> bool:
    """Return whether the range of points, shape (n, parameters), is below ``spread`` in every coordinate."""
    for j in range(points.shape[1]):
        smallest = largest = points[0, j]
        for i in range(1, points.shape[0]):
            smallest, largest = min(smallest, points[i, j]), max(largest, points[i, j])
        if largest - smallest >= spread:
            return False
    return True


def compiled(search: Callable[[Any], Any], problem: Problem) -> Any:
    """Compile a search of a problem's residuals, or load it from the cache.

    Args:
        search: function at the top level of a module that returns the compiled search for a residual function.
        problem: the problem.

    Returns:
        The compiled search.

    Raises:
        BadInput: the residuals are not compiled, or cannot be imported from another module.
    """
    residuals, where = problem.residuals, problem.name
    name = getattr(residuals, "__name__", repr(residuals))
    if extending.is_jitted(residuals) != extending.is_jitted(place):
        raise BadInput(f"residuals {name} are not compiled", where, "a function decorated with numba.njit")
    module = sys.modules.get(residuals.__module__)
    if module is None or module.__file__ is None or getattr(module, name, None) is not residuals:
        raise BadInput(f"residuals {name} cannot be imported", where, "a function at the top level of a module's file")
    return _compiled(search, residuals)


class _Search(NamedTuple):
    """A compiled search."""

    run: Callable[..., Any]


@cache
def _compiled(search: Callable[[Any], Any], residuals: Any) -> Any:
    return composition.compiled(_build, {"run": "*arguments"}, {"search": search, "residuals": residuals}).run


def _build(search: Callable[[Any], Any], residuals: Any) -> _Search:
    """Build the search for a residual function."""
    return _Search(search(residuals))
