"""Least squares with forgetting, from sums that grow by a row at a time."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array, kernel

LARGEST_NOISE = 0.5
"""Most of a regressor's square that may be its sensor's noise, before it tells nothing."""


@kernel
def gather(row: Array, fading: float, sums: Array, count: Array) -> None:
    """Add a row to the sums.

    Args:
        row: regressors, and the value that they explain, last; shape (n,).
        fading: what remains of the earlier rows' weight [1].
        sums: sums of the products of any two entries, shape (n, n); the lower triangle is used.
        count: sum of the weights, shape (1,).
    """
    for i in range(row.size):
        for j in range(i + 1):
            sums[i, j] = fading * sums[i, j] + row[i] * row[j]
    count[0] = fading * count[0] + 1.0


class Fit(NamedTuple):
    """A solution.

    Attributes:
        values: coefficients, shape (n,).
        covariance: theirs, shape (n, n).
        residual: standard deviation of what is not explained.
    """

    values: Array
    covariance: Array
    residual: float

    def std(self, direction: Array) -> float:
        """Return the standard error of a linear combination of the coefficients, by their weights, shape (n,)."""
        return math.sqrt(max(float(direction @ self.covariance @ direction), 0.0))


def whole(sums: Array) -> Array:
    """Return symmetric sums from those that :func:`gather` filled."""
    return np.tril(sums) + np.tril(sums, -1).T


def audible(squares: Array, count: float, noise: Array) -> NDArray[np.bool_]:
    """Tell which regressors, by the sums of their squares, are more than their noise of a variance ``noise``; shape (n,)."""
    heard: NDArray[np.bool_] = count * noise <= LARGEST_NOISE * squares
    return heard


def solve(sums: Array, count: float, noise: Array, prior: Array) -> Fit | None:
    """Solve for the coefficients of the regressors.

    Args:
        sums: symmetric, shape (n + 1, n + 1).
        count: sum of the rows' weights.
        noise: variance of each regressor's noise, shape (n,): without its removal, noise would draw coefficients to 0
            (Fuller, Measurement Error Models, 1987, section 2.2).
        prior: how well each coefficient is known to be zero, one over its standard deviation, shape (n,).

    Returns:
        The solution; None where the rows do not tell the coefficients apart, are too few, or hold little but noise.
    """
    n = len(sums) - 1
    squares, products = sums[:n, :n], sums[:n, n]
    if count < 4.0 * n or not np.all(audible(np.diag(squares), count, noise)):
        return None
    removed = count * noise
    # In units of the regressors' own sizes, as they differ by many powers of ten.
    size = np.sqrt(np.diag(squares))
    if not np.all(size > 0.0):
        return None
    information = (squares - np.diag(removed)) / np.outer(size, size)
    try:
        rough = np.linalg.solve(information + 1e-12 * np.eye(n), products / size)
        variance = _variance(squares, products, float(sums[n, n]), rough / size, count)
        known = variance * (prior / size) ** 2
        inverse = np.linalg.inv(information + np.diag(known))
    except np.linalg.LinAlgError:
        return None
    values = inverse @ (products / size) / size
    if not np.all(np.isfinite(values)) or not np.all(np.diag(inverse) > 0.0):
        return None
    variance = _variance(squares, products, float(sums[n, n]), values, count)
    return Fit(values, variance * inverse / np.outer(size, size), float(np.sqrt(variance)))


def _variance(squares: Array, products: Array, total: float, values: Array, count: float) -> float:
    """Return the mean square of what remains, never below the rounding of its sum."""
    remains = total - 2.0 * float(values @ products) + float(values @ squares @ values)
    return max(remains, 1e-14 * total) / (count - len(values))
