"""Random numbers inside compiled kernels: seeded, without allocation, independent of every other generator.

SplitMix64: G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array, kernel

State = NDArray[np.uint64]
"""State of the generator, shape (1,); initially the seed."""

_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_11, _27, _30, _31 = np.uint64(11), np.uint64(27), np.uint64(30), np.uint64(31)


@kernel
def uniform(state: State) -> float:
    """Return a uniform random number of [0, 1)."""
    state[0] += _STEP
    z = state[0]
    z = (z ^ (z >> _30)) * _FIRST
    z = (z ^ (z >> _27)) * _SECOND
    return ((z ^ (z >> _31)) >> _11) * 2.0**-53


@kernel
def index(state: State, size: int) -> int:
    """Return a random integer from 0 to size - 1."""
    return int(uniform(state) * size)


@kernel
def latin_hypercube(state: State, points: Array) -> None:
    """Fill ``points``, shape (n, parameters), with a Latin hypercube: one point in every n-th of each axis."""
    n, size = points.shape
    for j in range(size):
        for i in range(n):
            points[i, j] = (i + uniform(state)) / n
        for i in range(n - 1, 0, -1):
            k = index(state, i + 1)
            points[i, j], points[k, j] = points[k, j], points[i, j]
