"""SciPy's least squares (trust region reflective), started from the best points of a Latin hypercube over the box."""

import math
from typing import Annotated, NamedTuple

import numpy as np
import scipy

from ehls_ros.identification.objective import Counted, Enough
from ehls_ros.identification.optimisers.base import Problem, Result
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Starting points and accuracy."""

    evaluations: Annotated[int, quantity("1", "most evaluations of the objective", minimum=1, maximum=10**9)] = 100_000
    samples: Annotated[int, quantity("1", "points of a Latin hypercube to start from", minimum=1, maximum=10**6)] = 100
    starts: Annotated[int, quantity("1", "how many of the best of them the solver starts from", minimum=1, maximum=10_000)] = 4
    tolerance: Annotated[float, quantity("1", "relative change of cost or point to end at", minimum=1e-15, maximum=1.0)] = 1e-10


def minimise(problem: Problem, p: Parameters, seed: int, target: float = -math.inf) -> Result:
    """Minimise the cost; the scattered points are one iteration, and so is each later trial step of the solver."""
    counted = Counted(problem, seed, p.evaluations, target)
    random = np.random.default_rng(seed)
    slices = random.permuted(np.tile(np.arange(p.samples), (counted.size, 1)), axis=1).T
    points = (slices + random.random(slices.shape)) / p.samples
    agreed = False
    try:
        costs = counted.costs(points)
        for k in np.argsort(costs)[: p.starts]:
            if not costs[k] < math.inf:
                break
            scipy.optimize.least_squares(
                counted.residuals,
                points[k],
                jac=counted.jacobian,
                bounds=(0.0, 1.0),
                ftol=p.tolerance,
                xtol=p.tolerance,
                gtol=None,
                max_nfev=p.evaluations,
            )
            agreed = True
    except Enough:
        agreed = False
    return counted.result(agreed=agreed)
