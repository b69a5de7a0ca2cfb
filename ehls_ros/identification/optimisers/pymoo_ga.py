"""pymoo's genetic algorithm with the library's defaults: simulated binary crossover, polynomial mutation."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.extras import library
from ehls_ros.identification.objective import Counted
from ehls_ros.identification.optimisers._pymoo import search
from ehls_ros.identification.optimisers.base import Problem, Result
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Size and convergence criteria of the population."""

    evaluations: Annotated[int, quantity("1", "most evaluations of the objective", minimum=1, maximum=10**9)] = 100_000
    population: Annotated[int, quantity("1", "size of the population", minimum=2, maximum=10_000)] = 100
    tolerance: Annotated[float, quantity("1", "relative fall of the cost that counts as one", above=0.0, maximum=1.0)] = 1e-8
    patience: Annotated[int, quantity("1", "generations without such a fall to end after", minimum=1, maximum=10**6)] = 100


def minimise(problem: Problem, p: Parameters, seed: int, target: float = -math.inf) -> Result:
    """Minimise the cost; an iteration is a generation."""
    genetic = library("pymoo.algorithms.soo.nonconvex.ga", "optimisers", problem.name).GA(pop_size=p.population)
    counted = Counted(problem, seed, p.evaluations, target, tolerance=p.tolerance, patience=p.patience)
    return search(counted, genetic, seed, problem.name)
