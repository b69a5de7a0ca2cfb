"""pyswarms' global-best particle swarm, with constriction coefficients and reflecting bounds.

These settings perform best on the paper's static objective; convergence to a minimum on a bound is poor. The library has had
no release since 2021.

The library draws from NumPy's global generator; on every start it reconfigures logging and opens ``report.log`` in the working
directory. Here the generator is restored afterwards, and the logging configuration is preserved.
"""

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.extras import library
from ehls_ros.identification.objective import Counted, Enough
from ehls_ros.identification.optimisers.base import Problem, Result
from ehls_ros.schema import quantity

_LARGEST = 1e300
"""Cost in place of infinity: a swarm with infinite costs only would crash."""


class Parameters(NamedTuple):
    """Size, coefficients and convergence criteria of the swarm."""

    evaluations: Annotated[int, quantity("1", "most evaluations of the objective", minimum=1, maximum=10**9)] = 100_000
    particles: Annotated[int, quantity("1", "size of the swarm", minimum=2, maximum=10_000)] = 30
    inertia: Annotated[float, quantity("1", "share w of its velocity a particle keeps", minimum=0.0, maximum=1.0)] = 0.7298
    cognitive: Annotated[float, quantity("1", "pull c1 of a particle's own best", minimum=0.0, maximum=4.0)] = 1.4962
    social: Annotated[float, quantity("1", "pull c2 of the swarm's best", minimum=0.0, maximum=4.0)] = 1.4962
    tolerance: Annotated[float, quantity("1", "relative fall of the cost that counts as one", above=0.0, maximum=1.0)] = 1e-8
    patience: Annotated[int, quantity("1", "iterations without such a fall to end after", minimum=1, maximum=10**6)] = 100


def minimise(problem: Problem, p: Parameters, seed: int, target: float = -math.inf) -> Result:
    """Minimise the cost; an iteration is one move of the swarm."""
    counted = Counted(problem, seed, p.evaluations, target, tolerance=p.tolerance, patience=p.patience)
    with _logging_left_alone(), _seeded(seed), suppress(Enough):
        swarm = library("pyswarms.single.global_best", "optimisers", problem.name).GlobalBestPSO(
            n_particles=p.particles,
            dimensions=counted.size,
            options={"w": p.inertia, "c1": p.cognitive, "c2": p.social},
            bounds=(np.zeros(counted.size), np.ones(counted.size)),
            bh_strategy="reflective",
        )
        swarm.optimize(lambda points: np.minimum(counted.costs(points), _LARGEST), iters=p.evaluations, verbose=False)
    return counted.result(agreed=False)


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, and restore it afterwards."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002


@contextmanager
def _logging_left_alone() -> Iterator[None]:
    """Supply the library with a logging configuration that changes nothing."""
    before = os.environ.get("LOG_CFG")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "nothing.yaml")
        path.write_text("{version: 1, incremental: true}", encoding="utf-8")
        os.environ["LOG_CFG"] = str(path)
        try:
            yield
        finally:
            if before is None:
                del os.environ["LOG_CFG"]
            else:
                os.environ["LOG_CFG"] = before
