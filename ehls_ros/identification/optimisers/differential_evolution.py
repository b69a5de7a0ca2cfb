"""SciPy's differential evolution, whole generations evaluated at once, without the final local search."""

import math
from typing import Annotated, NamedTuple

import numpy as np
import scipy

from ehls_ros.identification.objective import Counted, Enough
from ehls_ros.identification.optimisers.base import Problem, Result
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Size and convergence criteria of the population."""

    evaluations: Annotated[int, quantity("1", "most evaluations of the objective", minimum=1, maximum=10**9)] = 100_000
    population: Annotated[int, quantity("1", "members for each parameter", minimum=1, maximum=10_000)] = 15
    tolerance: Annotated[
        float,
        quantity("1", "spread of the members, in relative cost or in place in the unit box, to end at", above=0.0, maximum=1.0),
    ] = 1e-8


def minimise(problem: Problem, p: Parameters, seed: int, target: float = -math.inf) -> Result:
    """Minimise the cost; an iteration is a generation."""
    counted = Counted(problem, seed, p.evaluations, target, tolerance=p.tolerance)
    try:
        scipy.optimize.differential_evolution(
            lambda points: counted.costs(points.T),
            [(0.0, 1.0)] * counted.size,
            popsize=p.population,
            tol=p.tolerance,
            maxiter=p.evaluations,
            polish=False,
            seed=np.random.default_rng(seed),
            vectorized=True,
            updating="deferred",
        )
    except Enough:
        return counted.result(agreed=False)
    return counted.result(agreed=True)
