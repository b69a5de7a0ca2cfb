"""Moving averages over periodic signals."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def mean_around(values: NDArray[Any], reach: int) -> NDArray[Any]:
    """Return the mean of each value and ``reach`` values on either side, with periodic continuation at the ends."""
    reach = min(reach, (len(values) - 1) // 2)
    if reach == 0:
        return values
    padded = np.concatenate([values[-reach:], values, values[:reach]])
    total = np.concatenate([[0.0], np.cumsum(padded)])
    width = 2 * reach + 1
    mean: NDArray[Any] = (total[width:] - total[:-width]) / width
    return mean if np.iscomplexobj(mean) else np.maximum(mean, 0.0)
