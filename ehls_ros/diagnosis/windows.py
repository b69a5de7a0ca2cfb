"""Derivatives and means of noisy signals: weak-form balances over short windows, and local polynomial fits.

The residual at one instant needs derivatives. Weighting by a smooth window φ that vanishes with its slope at both ends, and
integration by parts, moves the derivatives to the window: ∫φ dx/dt = -∫φ' x, ∫φ d²x/dt² = ∫φ'' x.

A local polynomial fit (Savitzky and Golay 1964) gives a signal or its derivative from the samples around each sample.
``scipy.signal`` has it too, and ``scipy.integrate`` the trapezoidal rule, but their imports alone take 60 MB and 25 MB in every
process that judges a recording.
"""

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.duals import linear

OVERLAP = 3
"""Windows of a balance that begin within the length of one, and over which their noise and the error of a local fit extend."""


class Window(NamedTuple):
    """A window of ``weights.size`` samples that begins every ``hop`` samples.

    Attributes:
        weights: φ, their sum is 1, shape (m,).
        slopes: dφ/dt [1/s], shape (m,).
        curvatures: d²φ/dt² [1/s^2], shape (m,).
        hop: samples between the beginnings of successive windows.
    """

    weights: Array
    slopes: Array
    curvatures: Array
    hop: int

    def starts(self, samples: int) -> NDArray[np.intp]:
        """Return the first sample of each window that fits into the given number of samples."""
        return np.arange(0, max(samples - self.weights.size + 1, 0), self.hop)

    def over(self, values: Any, weights: Array) -> Any:
        """Return the weighted sum of a signal over each window; a dual for a dual signal."""
        return linear(partial(self._sums, weights), values)

    def _sums(self, weights: Array, values: Array) -> Array:
        count = (len(values) - weights.size) // self.hop + 1
        if count < 1:
            return np.empty(0)
        [step] = values.strides
        # A view without the checks of sliding_window_view, which take as long as the product.
        sums: Array = as_strided(values, (count, weights.size), (self.hop * step, step), writeable=False) @ weights
        return sums

    def mean(self, values: Any) -> Any:
        """Return the weighted mean of a signal over each window."""
        return self.over(values, self.weights)

    def rate(self, values: Any) -> Any:
        """Return the weighted mean of a signal's derivative over each window."""
        return -self.over(values, self.slopes)

    def acceleration(self, values: Any) -> Any:
        """Return the weighted mean of a signal's second derivative over each window."""
        return self.over(values, self.curvatures)


def smooth_window(samples: int, period: float, hop: int = OVERLAP) -> Window:
    """Return a sin^4 window over a number of sampling periods, with ``hop`` windows beginning within one length."""
    angle = np.pi * np.arange(samples + 1) / samples
    scale = np.pi / (samples * period)
    sine, cosine = np.sin(angle), np.cos(angle)
    weights = sine**4
    total = float(np.sum(weights))
    slopes = 4.0 * sine**3 * cosine * scale
    curvatures = (12.0 * sine**2 * cosine**2 - 4.0 * sine**4) * scale**2
    # Sums differ from integrals: scaled to reproduce the slope of a line and the curvature of a parabola with few samples too.
    time = period * (np.arange(samples + 1) - 0.5 * samples)
    slopes *= -1.0 / float(np.sum(slopes * time))
    curvatures -= weights / total * float(np.sum(curvatures))
    curvatures *= 2.0 / float(np.sum(curvatures * time**2))
    return Window(weights / total, slopes, curvatures, max(1, samples // hop))


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
