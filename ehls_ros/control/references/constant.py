"""A constant value."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """The value."""

    value: Annotated[float, quantity("N or m", "the value held", minimum=-1e6, maximum=1e6)] = 1e4


def sample(t: Array, p: Parameters) -> Array:
    """Return the constant and its zero derivatives."""
    out = np.zeros((t.size, 3))
    out[:, 0] = p.value
    return out
