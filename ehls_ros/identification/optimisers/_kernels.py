"""What the optimisers compile: a problem's cost on the unit box, and the module that composes it with a search.

All optimisers search the unit box; ``lower + u (upper - lower)`` is the point meant by u.
"""

import hashlib
import math
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import extending, njit

from ehls_ros.arrays import Array, kernel
from ehls_ros.errors import BadInput
from ehls_ros.identification.optimisers.base import Problem
from ehls_ros.physics.composition import kernel_module

STEP = 2.0**-26
"""Step of differences in the unit box: the root of a double's resolution."""


@njit(error_model="numpy", forceinline=True, fastmath={"contract", "reassoc"})
def half_square(r: Array) -> float:
    """Return half the sum of the squares, summed up in the order that is fastest; infinity where it is no number."""
    total = 0.0
    for k in range(r.size):
        total += r[k] * r[k]
    return min(math.inf, 0.5 * total)  # infinity, too, where the total is not a number


@kernel
def place(u: Array, lower: Array, upper: Array, x: Array) -> None:
    """Write the point of the problem's box that u means into ``x``."""
    for j in range(u.size):
        # The sum could round to beyond the bound.
        x[j] = min(max(lower[j] + u[j] * (upper[j] - lower[j]), lower[j]), upper[j])


def cost(residuals: Any) -> Any:
    """Return the compiled cost at a point of the unit box, for a residual function."""

    @kernel
    def cost_at(u: Array, data: Any, lower: Array, upper: Array, x: Array, r: Array) -> float:
        place(u, lower, upper, x)
        residuals(x, data, r)
        return half_square(r)

    return cost_at


def jacobian(residuals: Any) -> Any:
    """Return the compiled derivatives by the coordinates of the unit box, for a residual function.

    They are differences to a point beside, on the side that is farther from a bound; to the other side where that one's
    residuals are not finite; zero where those are not, either.
    """
    cost_at = cost(residuals)

    @kernel
    def derivatives(
        u: Array, r: Array, data: Any, lower: Array, upper: Array, x: Array, moved: Array, beside: Array, out: Array
    ) -> None:
        for j in range(u.size):
            moved[j] = u[j]
        for j in range(u.size):
            step = STEP if u[j] < 0.5 else -STEP
            for _ in range(2):
                moved[j] = u[j] + step
                finite = cost_at(moved, data, lower, upper, x, beside) < math.inf
                if finite:
                    break
                step = -step
            for k in range(r.size):
                out[k, j] = (beside[k] - r[k]) / (moved[j] - u[j]) if finite else 0.0
            moved[j] = u[j]

    return derivatives


@kernel
def gathered(points: Array, spread: float) -> bool:
    """Return whether no coordinate of points, shape (n, parameters), spreads as wide as this."""
    for j in range(points.shape[1]):
        smallest = largest = points[0, j]
        for i in range(1, points.shape[0]):
            smallest, largest = min(smallest, points[i, j]), max(largest, points[i, j])
        if largest - smallest >= spread:
            return False
    return True


def composed(template: str, problem: Problem) -> ModuleType:
    """Compile (or load) a search for a problem's residuals.

    Args:
        template: text of a module with its compiled entries, ``{residuals}`` where it imports the residuals.
        problem: the problem.

    Returns:
        The module.

    Raises:
        BadInput: the residuals are not compiled, or no other module could import them.
    """
    residuals, where = problem.residuals, problem.name
    name = getattr(residuals, "__name__", repr(residuals))
    if extending.is_jitted(residuals) != extending.is_jitted(place):
        raise BadInput(f"residuals {name} are not compiled", where, "a function decorated with numba.njit")
    module = sys.modules.get(residuals.__module__)
    if module is None or module.__file__ is None or getattr(module, name, None) is not residuals:
        raise BadInput(f"residuals {name} cannot be imported", where, "a function at the top level of a module's file")
    return _composed(template, module.__name__, name, module.__file__)


@cache
def _composed(template: str, module: str, name: str, file: str) -> ModuleType:
    # The residuals may lie outside the package; a change of theirs, or of what they and the search use, makes another module.
    sources = sorted(Path(__file__).parents[1].rglob("*.py"))
    text = b"".join(path.read_bytes() for path in [*sources, Path(file)])
    line = f"from {module} import {name} as residuals  # {hashlib.sha256(text).hexdigest()[:16]}"
    return kernel_module(template.format(residuals=line))
