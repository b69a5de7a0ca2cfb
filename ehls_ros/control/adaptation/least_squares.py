"""Least squares with forgetting, from sums updated by one row at a time."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array, kernel

MAX_NOISE_SHARE = 0.5
"""Largest noise share of a regressor's mean square for which it is used."""


@kernel
def gather(row: Array, fading: float, sums: Array, count: Array) -> None:
    """Add a row to the sums.

    Args:
        row: regressors, and last the value that they explain; shape (n,).
        fading: forgetting factor of the earlier rows' weight [1].
        sums: sums of the products of any two entries, shape (n, n); the lower triangle is used.
        count: sum of the weights, shape (1,).
    """
    for i in range(row.size):
        for j in range(i + 1):
            sums[i, j] = fading * sums[i, j] + row[i] * row[j]
    count[0] = fading * count[0] + 1.0


class Fit(NamedTuple):
    """Least-squares solution.

    Attributes:
        values: coefficients, shape (n,).
        covariance: covariance of the coefficients, shape (n, n).
        residual: standard deviation of the residual.
    """

    values: Array
    covariance: Array
    residual: float

    def std(self, direction: Array) -> float:
        """Return the standard error of a linear combination of the coefficients, by their weights, shape (n,)."""
        return math.sqrt(max(float(direction @ self.covariance @ direction), 0.0))


def symmetric(sums: Array) -> Array:
    """Return the symmetric sums from the lower triangle filled by :func:`gather`."""
    return np.tril(sums) + np.tril(sums, -1).T


def above_noise(squares: Array, count: float, noise: Array) -> NDArray[np.bool_]:
    """Return a mask of the regressors whose sums of squares exceed their noise of variance ``noise``; shape (n,)."""
    above: NDArray[np.bool_] = count * noise <= MAX_NOISE_SHARE * squares
    return above


def solve(sums: Array, count: float, noise: Array, prior: Array) -> Fit | None:
    """Solve for the coefficients of the regressors.

    Args:
        sums: symmetric sums, shape (n + 1, n + 1).
        count: sum of the rows' weights.
        noise: variance of each regressor's noise, shape (n,): without its removal, noise would draw coefficients to 0
            (Fuller, Measurement Error Models, 1987, section 2.2).
        prior: inverse of each coefficient's prior standard deviation about zero, shape (n,).

    Returns:
        The solution; None if the rows do not separate the coefficients, are too few, or contain little but noise.
    """
    n = len(sums) - 1
    squares, products = sums[:n, :n], sums[:n, n]
    if count < 4.0 * n or not np.all(above_noise(np.diag(squares), count, noise)):
        return None
    removed = count * noise
    # Scaled by the regressors' sizes, as they differ by many powers of ten.
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
    """Return the residual variance, never below the rounding of its sum."""
    remains = total - 2.0 * float(values @ products) + float(values @ squares @ values)
    return max(remains, 1e-14 * total) / (count - len(values))
