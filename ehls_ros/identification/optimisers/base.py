"""Interface of an optimiser's file, and the problem solved by all of them.

A file provides ``Parameters``, a named tuple that declares the optimiser's parameters, among them ``evaluations``, the largest
number of evaluations of the objective. It also provides ``minimise(problem, parameters, seed, target)``, which seeks the x
within the bounds with the least half sum of squared residuals.

A search that ends without having converged is a result with advice; an ill-posed problem raises
:class:`~ehls_ros.errors.BadInput`. The same seed gives the same result on the same machine.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput


class Problem(NamedTuple):
    """A sum of squares within a box.

    Attributes:
        residuals: function ``residuals(x, data, out)`` at the top level of a module, compiled by numba, that writes the
            residuals at x, shape (parameters,), into ``out``, shape (residual_count,). If one is not finite, the cost of x is
            infinite.
        data: its data, a tuple or named tuple of arrays and numbers.
        residual_count: number of residuals.
        lower: lower bounds, shape (parameters,).
        upper: upper bounds, shape (parameters,), above the lower ones.
        name: its name in errors.
    """

    residuals: Callable[[Array, Any, Array], None]
    data: Any
    residual_count: int
    lower: Array
    upper: Array
    name: str = "problem"


class Result(NamedTuple):
    """Result of a search.

    Attributes:
        x: best point, shape (parameters,), within the bounds.
        cost: half the sum of its squared residuals.
        evaluations: number of evaluations of the residuals.
        history: lowest cost after each iteration, as the optimiser counts them.
        converged: whether the optimiser's convergence criterion was met, or the target was reached.
        advice: remedy if it has not converged; else empty.
    """

    x: Array
    cost: float
    evaluations: int
    history: Array
    converged: bool
    advice: str


class Optimiser(Protocol):
    """Attributes of one optimiser's file."""

    Parameters: Any

    def minimise(self, problem: Problem, p: Any, seed: int, target: float = ...) -> Result:
        """Minimise the cost of a problem.

        Args:
            problem: the problem.
            p: parameters of the optimiser.
            seed: seed of its random numbers, 0 to 2^32 - 1.
            target: cost at which to stop at once, for benchmarks; ``-inf``: none.

        Returns:
            The best point found, with the history of the search.

        Raises:
            BadInput: the problem's bounds, residual_count or seed cannot be used, or the optimiser's library is not installed.
        """


def checked(problem: Problem, seed: int) -> Problem:
    """Return the problem with its bounds as contiguous arrays.

    Raises:
        BadInput: bounds, residual_count or seed cannot be used.
    """
    lower, upper = (np.ascontiguousarray(bound, dtype=np.float64) for bound in (problem.lower, problem.upper))
    if lower.ndim != 1 or lower.shape != upper.shape or not lower.size:
        shapes = f"bounds of shape {lower.shape} and {upper.shape}"
        raise BadInput(shapes, problem.name, "one lower and one upper bound a parameter")
    for j, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        if not np.isfinite(high - low):
            raise BadInput(f"bounds {low:g} to {high:g} of parameter {j}", problem.name, "finite bounds")
        if not low < high:
            raise BadInput(f"bounds {low:g} to {high:g} of parameter {j}", problem.name, "a lower bound below the upper one")
    if problem.residual_count < 1:
        raise BadInput(f"residual_count is {problem.residual_count}", problem.name, "one residual or more")
    if not 0 <= seed < 2**32:
        raise BadInput(f"seed is {seed}", problem.name, "0 to 2^32 - 1")
    return problem._replace(lower=lower, upper=upper)


def ended(problem: Problem, u: Array, cost: float, evaluations: int, history: Array, agreed: bool, target: float) -> Result:
    """Return the result of a search on the unit box.

    Args:
        problem: the minimised problem.
        u: best point in the unit box.
        cost: its cost.
        evaluations: number of evaluations used.
        history: lowest cost after each iteration.
        agreed: whether the optimiser's convergence criterion was met.
        target: cost at which to stop.
    """
    x = np.minimum(problem.lower + u * (problem.upper - problem.lower), problem.upper)
    if not np.isfinite(cost):
        advice = f"no finite residuals in {evaluations} evaluations: look at the data, or narrow the bounds"
    elif agreed or cost <= target:
        advice = ""
    else:
        advice = f"not yet converged after {evaluations} evaluations: allow more of them, or narrow the bounds"
    return Result(x, cost, evaluations, history, not advice, advice)
