"""pymoo's particle swarm with the library's defaults: adaptive weights, and perturbation of the best particle."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.extras import library
from ehls_ros.identification.objective import Counted
from ehls_ros.identification.optimisers._pymoo import search
from ehls_ros.identification.optimisers.base import Problem, Result
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Size and convergence criteria of the swarm."""

    evaluations: Annotated[int, quantity("1", "most evaluations of the objective", minimum=1, maximum=10**9)] = 100_000
    particles: Annotated[int, quantity("1", "size of the swarm", minimum=2, maximum=10_000)] = 25
    tolerance: Annotated[float, quantity("1", "relative fall of the cost that counts as one", above=0.0, maximum=1.0)] = 1e-8
    patience: Annotated[int, quantity("1", "iterations without such a fall to end after", minimum=1, maximum=10**6)] = 100


def minimise(problem: Problem, p: Parameters, seed: int, target: float = -math.inf) -> Result:
    """Minimise the cost; an iteration is one move of the swarm."""
    swarm = library("pymoo.algorithms.soo.nonconvex.pso", "optimisers", problem.name).PSO(pop_size=p.particles)
    counted = Counted(problem, seed, p.evaluations, target, tolerance=p.tolerance, patience=p.patience)
    return search(counted, swarm, seed, problem.name)
