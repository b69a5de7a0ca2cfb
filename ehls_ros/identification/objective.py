"""Objective of the optimisers: compiled and counted evaluation of points of the unit box in batches, with the best one kept."""

import math
from typing import Any

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.identification.optimisers._kernels import Box, Work, box_of, compiled, cost, jacobian, within_spread, work_of
from ehls_ros.identification.optimisers.base import Problem, Result, checked, ended


def batch(residuals: Any) -> Any:
    """Return the compiled costs of several points, for a residual function."""
    cost_at = cost(residuals)

    @kernel
    def run(points: Array, spread: float, box: Box, work: Work, out: Array) -> bool:
        """Write the costs of the first points, shape (n, parameters), into ``out``, shape (at most n,).

        Returns:
            Whether the range of the points is below ``spread`` in every coordinate.
        """
        for k in range(out.size):
            out[k] = cost_at(points[k], box, work)
        return within_spread(points, spread)

    return run


class Enough(Exception):
    """Raised to end a search that has converged, reached the target or used up its evaluations."""


class Counted:
    """Objective with counted evaluations.

    Attributes:
        size: number of parameters.
        evaluations: number of evaluations so far.
        best: best point so far in the unit box, shape (parameters,).
        lowest: its cost.
    """

    def __init__(
        self, problem: Problem, seed: int, budget: int, target: float, *, tolerance: float = 0.0, patience: int = 0
    ) -> None:
        """Check and compile the problem.

        Args:
            problem: the problem to minimise.
            seed: the seed, checked only.
            budget: maximum number of evaluations.
            target: cost at which to stop.
            tolerance: a batch of points narrower than this in the unit box has converged.
            patience: number of batches without a relative decrease of the cost by the tolerance after which the search counts
                as converged; 0: never.

        Raises:
            BadInput: the problem is ill-posed.
        """
        self._problem = checked(problem, seed)
        self._batch = compiled(batch, self._problem)
        self._cost = compiled(cost, self._problem)
        self._jacobian = compiled(jacobian, self._problem)
        self._box, self._work = box_of(self._problem), work_of(self._problem)
        self.size = self._problem.lower.size
        self._at = np.full(self.size, np.nan), self._work.r
        self._budget = budget
        self._target = target
        self._tolerance = tolerance
        self._patience = patience
        self._converged = False
        self._history: list[float] = []
        self.evaluations = 0
        self.best = np.full(self.size, 0.5)
        self.lowest = math.inf

    def costs(self, points: Array) -> Array:
        """Return the costs of points of the unit box, shape (n, parameters), and count one iteration.

        Raises:
            Enough: the target is reached, the search has converged, or the evaluations are used up.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        afforded = min(len(points), self._budget - self.evaluations)
        out = np.full(len(points), math.inf)
        close = self._batch(points, self._tolerance, self._box, self._work, out[:afforded])
        self.evaluations += afforded
        first = int(out.argmin())
        self._noted(points[first], float(out[first]))
        self._converged = close or self._stagnates()
        if self._converged or afforded < len(points):
            raise Enough
        return out

    def residuals(self, u: Array) -> Array:
        """Return the residuals at a point of the unit box, shape (residual_count,), and count one iteration.

        Raises:
            Enough: the target is reached, or the evaluations are used up.
        """
        self._afford(1)
        found = self._cost(u, self._box, self._work)
        self._at = u.copy(), self._work.r.copy()
        self._noted(u, found)
        return self._at[1]

    def jacobian(self, u: Array) -> Array:
        """Return the residuals' derivatives by the coordinates of the unit box, shape (residual_count, parameters).

        Args:
            u: point, preferably that of the last call of :meth:`residuals`.

        Raises:
            Enough: the evaluations are used up.
        """
        if not np.array_equal(u, self._at[0]):
            self.residuals(u)
        self._afford(self.size)
        out = np.empty((self._work.r.size, self.size))
        self._jacobian(u, self._at[1], self._box, self._work, out)
        return out

    def result(self, *, agreed: bool) -> Result:
        """Return the best point; ``agreed`` states whether the search met its convergence criterion."""
        agreed = agreed or self._converged
        history = np.array(self._history)
        return ended(self._problem, self.best, self.lowest, self.evaluations, history, agreed, self._target)

    def _stagnates(self) -> bool:
        if not 0 < self._patience < len(self._history):
            return False
        before = self._history[-1 - self._patience]
        return before < math.inf and before - self.lowest <= self._tolerance * before

    def _afford(self, evaluations: int) -> None:
        if self.evaluations + evaluations > self._budget:
            raise Enough
        self.evaluations += evaluations

    def _noted(self, u: Array, cost: float) -> None:
        if cost < self.lowest:
            self.lowest, self.best = cost, u.copy()
        self._history.append(self.lowest)
        if self.lowest <= self._target:
            raise Enough
