"""Common driver of pymoo's optimisers."""

from contextlib import suppress
from typing import Any

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.extras import library
from ehls_ros.identification.objective import Counted, Enough
from ehls_ros.identification.optimisers.base import Result


def search(counted: Counted, algorithm: Any, seed: int, where: str) -> Result:
    """Run one of pymoo's algorithms until the objective stops it.

    Args:
        counted: the objective.
        algorithm: the algorithm.
        seed: seed of its random numbers.
        where: name of the problem, for errors.
    """

    def evaluate(_: Any, points: Array, out: dict[str, Any], *_rest: Any, **_options: Any) -> None:
        out["F"] = counted.costs(points)[:, None]

    kind = type("Objective", (library("pymoo.core.problem", "optimisers", where).Problem,), {"_evaluate": evaluate})
    objective = kind(n_var=counted.size, n_obj=1, xl=np.zeros(counted.size), xu=np.ones(counted.size))
    never = library("pymoo.core.termination", "optimisers", where).NoTermination()
    with suppress(Enough):
        library("pymoo.optimize", "optimisers", where).minimize(objective, algorithm, never, seed=seed, verbose=False)
    return counted.result(agreed=False)
