"""Local polynomial fits (Savitzky and Golay 1964): a signal or its derivative from the samples around each sample.

``scipy.signal`` has them too, and ``scipy.integrate`` the trapezoidal rule, but their imports alone take 60 MB and 25 MB in
every process that judges a recording.
"""

import math
from functools import cache

import numpy as np

from ehls_ros.arrays import Array


@cache
def local_row(samples: int, degree: int, derivative: int, period: float) -> Array:
    """Return the filter weights, oldest sample first, for the value or derivative at the middle, shape (samples,).

    Args:
        samples: of the fit, an odd number.
        degree: of the polynomial.
        derivative: order of the derivative; 0 for the value.
        period: between two samples [s].
    """
    half = samples // 2
    # In units of half the window, the powers are of similar size.
    offsets = np.arange(-half, half + 1) / half
    fit = np.linalg.pinv(np.vander(offsets, degree + 1, increasing=True))
    row: Array = fit[derivative] * math.factorial(derivative) / (half * period) ** derivative
    row.flags.writeable = False
    return row


def local_slope(values: Array, samples: int, period: float) -> Array:
    """Return the slope of a local line fit at each sample; at the ends, that of the outermost fit, shape (n,).

    Args:
        values: the signal, shape (n,).
        samples: of each fit, an odd number, at most n.
        period: between two samples [s].
    """
    inside = np.convolve(values, local_row(samples, 1, 1, period)[::-1], mode="valid")
    return np.pad(inside, samples // 2, mode="edge")


def integral(values: Array, period: float) -> Array:
    """Return the integral of a signal from its first sample by the trapezoidal rule, shape (n,).

    Args:
        values: the signal, shape (n,).
        period: between two samples [s].
    """
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))]) * period
