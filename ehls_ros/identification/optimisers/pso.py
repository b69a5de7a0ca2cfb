"""Particle swarm with crossover and mutation: compiled version of the paper's optimiser.

The paper states only that "crossover and mutation factor based on the idea of GA" were introduced. Operators and numbers were
therefore chosen here, on the paper's static objective:

* Swarm: v = w v + c1 r1 (p_i - x) + c2 r2 (g - x), x = x + v, reflected at the bounds. The constriction coefficients are those
  of M. Clerc, J. Kennedy, IEEE Trans. Evol. Comput. 6 (2002) for c1 + c2 = 4.25. Each particle has one number r1 and one r2 for
  all coordinates, so that no direction is preferred.
* Crossover: a personal best p_i yields the child p_i + F (p_a - p_i + p_b - p_c). The members p_b and p_c are drawn at random,
  and p_a is the better of two such draws. F is from 0.5 to 1. The difference of two members tends to point along a valley, as
  in differential evolution.
* Mutation: a coordinate of the child is occasionally drawn anew from its whole range.

A child replaces its parent p_i if it is better. The search ends when all personal bests agree. It uses neither a gradient nor
a final local search.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.identification.optimisers import _random
from ehls_ros.identification.optimisers._kernels import Box, Work, box_of, compiled, cost, within_spread, work_of
from ehls_ros.identification.optimisers._random import State, index, uniform
from ehls_ros.identification.optimisers.base import Problem, Result, checked, ended
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Size and coefficients of the swarm."""

    evaluations: Annotated[int, quantity("1", "most evaluations of the objective", minimum=1, maximum=10**9)] = 100_000
    particles: Annotated[int, quantity("1", "size of the swarm", minimum=4, maximum=10_000)] = 20
    inertia: Annotated[float, quantity("1", "share w of its velocity a particle keeps", minimum=0.0, maximum=1.0)] = 0.61
    cognitive: Annotated[float, quantity("1", "pull c1 of a particle's own best", minimum=0.0, maximum=4.0)] = 1.295
    social: Annotated[float, quantity("1", "pull c2 of the swarm's best", minimum=0.0, maximum=4.0)] = 1.295
    crossovers: Annotated[int, quantity("1", "children per personal best and iteration", minimum=0, maximum=100)] = 2
    crossover_rate: Annotated[
        float, quantity("1", "share of a child's coordinates that are crossed", minimum=0.0, maximum=1.0)
    ] = 0.9
    mutation_rate: Annotated[float, quantity("1", "share of a child's coordinates drawn anew", minimum=0.0, maximum=1.0)] = 0.02
    tolerance: Annotated[
        float,
        quantity("1", "spread of the personal bests to end at, in relative cost or in the unit box", above=0.0, maximum=1.0),
    ] = 1e-8


class Swarm(NamedTuple):
    """Preallocated memory of the kernel for n particles in the unit box.

    Attributes:
        position: positions of the particles, shape (n, parameters).
        velocity: their velocities, same shape.
        best: their personal bests, same shape.
        cost: cost of each personal best, shape (n,).
        candidate: point to evaluate next, shape (parameters,).
        work: scratch memory of the objective.
        random: state of the random numbers.
    """

    position: Array
    velocity: Array
    best: Array
    cost: Array
    candidate: Array
    work: Work
    random: State


@kernel
def _reflected(u: float) -> float:
    """Return u reflected at the ends of [0, 1], at most once."""
    u = abs(u)
    return min(u, 1.0) if u <= 1.0 else max(2.0 - u, 0.0)


@kernel
def _move(i: int, leader: int, p: Parameters, swarm: Swarm) -> None:
    """Move a particle and make its new position the candidate."""
    own, common = p.cognitive * uniform(swarm.random), p.social * uniform(swarm.random)
    for j in range(swarm.candidate.size):
        u = swarm.position[i, j]
        v = p.inertia * swarm.velocity[i, j] + own * (swarm.best[i, j] - u) + common * (swarm.best[leader, j] - u)
        v = min(max(v, -0.5), 0.5)
        if not 0.0 <= u + v <= 1.0:
            u, v = _reflected(u + v), -0.5 * v
        else:
            u += v
        swarm.position[i, j], swarm.velocity[i, j], swarm.candidate[j] = u, v, u


@kernel
def _cross(i: int, p: Parameters, swarm: Swarm) -> None:
    """Cross a personal best with others and make the child the candidate."""
    n, size = swarm.best.shape
    a, rival = index(swarm.random, n), index(swarm.random, n)
    if swarm.cost[rival] < swarm.cost[a]:
        a = rival
    b, c = index(swarm.random, n), index(swarm.random, n)
    factor = 0.5 + 0.5 * uniform(swarm.random)
    always = index(swarm.random, size)
    for j in range(size):
        u = swarm.best[i, j]
        if j == always or uniform(swarm.random) < p.crossover_rate:
            u = _reflected(u + factor * (swarm.best[a, j] - u + swarm.best[b, j] - swarm.best[c, j]))
        if uniform(swarm.random) < p.mutation_rate:
            u = uniform(swarm.random)
        swarm.candidate[j] = u


@kernel
def _scatter(swarm: Swarm) -> None:
    """Place the particles, at rest, on a Latin hypercube."""
    _random.latin_hypercube(swarm.random, swarm.position)
    n, size = swarm.position.shape
    for i in range(n):
        swarm.cost[i] = math.inf
        for j in range(size):
            swarm.best[i, j], swarm.velocity[i, j] = swarm.position[i, j], 0.0


def search(residuals: Any) -> Any:
    """Return the compiled search for a residual function."""
    cost_at = cost(residuals)

    @kernel
    def run(box: Box, p: Parameters, target: float, swarm: Swarm, history: Array) -> tuple[int, int, int, bool]:
        """Run the search.

        Args:
            box: the problem.
            p: parameters.
            target: cost at which to stop.
            swarm: the memory; ``random`` is seeded.
            history: receives the lowest cost after each iteration.

        Returns:
            Number of the best particle, evaluations, iterations, and whether the personal bests agree.
        """
        _scatter(swarm)
        leader, evaluations, iterations = 0, 0, 0
        while True:
            # In the first iteration the particles do not move: they are at rest at their personal bests.
            for phase in range(1 + p.crossovers if iterations > 0 else 1):
                for i in range(swarm.cost.size):
                    if phase == 0:
                        _move(i, leader if iterations > 0 else i, p, swarm)
                    else:
                        _cross(i, p, swarm)
                    found = cost_at(swarm.candidate, box, swarm.work)
                    evaluations += 1
                    if found < swarm.cost[i]:
                        swarm.cost[i] = found
                        for j in range(swarm.candidate.size):
                            swarm.best[i, j] = swarm.candidate[j]
                        if found < swarm.cost[leader]:
                            leader = i
                    history[iterations] = swarm.cost[leader]
                    if swarm.cost[leader] <= target or evaluations >= p.evaluations:
                        return leader, evaluations, iterations + 1, False
            iterations += 1
            if _agree(p.tolerance, swarm):
                return leader, evaluations, iterations, True

    return run


@kernel
def _agree(tolerance: float, swarm: Swarm) -> bool:
    """Return whether the personal bests agree, in cost or in position."""
    lowest = highest = swarm.cost[0]
    for found in swarm.cost:
        lowest, highest = min(lowest, found), max(highest, found)
    if not highest < math.inf:
        return False
    return highest - lowest <= tolerance * lowest or within_spread(swarm.best, tolerance)


def minimise(problem: Problem, p: Parameters, seed: int, target: float = -math.inf) -> Result:
    """Minimise the cost; an iteration is one move of the swarm and the crossovers after it."""
    problem = checked(problem, seed)
    n, size = p.particles, problem.lower.size
    swarm = Swarm(
        position=np.empty((n, size)),
        velocity=np.empty((n, size)),
        best=np.empty((n, size)),
        cost=np.empty(n),
        candidate=np.empty(size),
        work=work_of(problem),
        random=np.array([seed], dtype=np.uint64),
    )
    history = np.empty(2 + p.evaluations // (n * (1 + p.crossovers)))
    run = compiled(search, problem)
    leader, evaluations, iterations, agreed = run(box_of(problem), p, float(target), swarm, history)
    return ended(problem, swarm.best[leader], float(swarm.cost[leader]), evaluations, history[:iterations], agreed, target)
