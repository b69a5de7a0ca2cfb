"""Prediction of the external force that repeats with the load cycle, as a preview for the law.

The smoothed force (:mod:`ehls_ros.control.learning.smoothing`) of a load cycle is d = x + n: x repeats, n does not. It does not
depend on the foreseen force, so that one load cycle shows all of x but the noise, and later ones only improve the mean. At each
harmonic the mean is multiplied by the gain of Wiener's filter,

    1 - V N / |mean|^2

with the variance N of n, from the differences of the force between successive load cycles, and its fraction V that remains in
the mean. N and |mean|^2 are averaged over :data:`NOISE_BANDWIDTH` on either side. So a force that does not repeat is hardly
foreseen.

Source: Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949, chapter 3.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.learning.periodic import PeriodicSignal, mean_around
from ehls_ros.control.learning.robustness import ROLL_OFF, Spectrum, falling

NOISE_BANDWIDTH = 2.0
"""Frequency on either side within which the noise is assumed constant [Hz]."""

NOISE_FACTOR = 1.5
"""Safety factor on the noise expected in the mean."""

RECENT = 2.0
"""Weight of a load cycle relative to the mean of all: the first ones, without preview, moved the actuator differently."""

MAX_CHANGE = 0.3
"""Rms difference of the force between successive load cycles, over the rms of its alternating part, above which it is not
foreseen: a law with a foreseen force follows any other force less closely."""

MIN_NOISE_WEIGHT = 0.1
"""Least weight of one load cycle in the noise's variance."""


MIN_POWER = 1e-12
"""Lower bound of a sum of squared amplitudes, for a force that never acts."""


class ForcePrediction(PeriodicSignal):
    """Estimate of the repeating force and its certainty.

    Attributes:
        change: rms difference between the last two load cycles, over the rms of the force's alternating part.
        spectrum: the foreseen force as an ``rfft``.
    """

    STORED = ("spectrum", "_mean", "_noise", "_latest", "_share")

    def __init__(self, size: int, period: float, bandwidth: float, forgetting: float) -> None:
        """Start without a foreseen force.

        Args:
            size: samples of the load cycle.
            period: length of the load cycle [s].
            bandwidth: bandwidth of the foreseen force [Hz].
            forgetting: fraction of the knowledge that is lost per load cycle.
        """
        super().__init__(size, period)
        self._forgetting = forgetting
        harmonics = np.arange(size // 2 + 1)
        edge = max(bandwidth, 1.0 / period)
        self._passed = falling(harmonics / period, edge, ROLL_OFF * edge)
        self._reach = max(1, round(NOISE_BANDWIDTH * period))
        nothing: Spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
        self.spectrum = self._mean = self._latest = nothing
        self._noise = np.full(size // 2 + 1, np.inf)
        self._share = np.array(0.0)
        self.change = 0.0

    def observe(self, force: Array, *, settled: bool = True) -> None:
        """Process the force of one load cycle.

        Args:
            force: smoothed force [N], shape (size,).
            settled: whether all of it repeats; of a cycle with a transition only the middle is compared with the next.
        """
        seen = np.fft.rfft(force)
        if not settled:
            self._latest = seen
            return
        self.cycles += 1
        change = seen - self._latest
        if np.any(self._latest) and self.cycles == 1:
            window = np.sin(math.pi * np.arange(self.size) / self.size) ** 2
            change = np.fft.rfft(window * np.fft.irfft(change, self.size)) / math.sqrt(float(np.mean(window**2)))
        if np.any(self._latest):
            self.change = math.sqrt(_power(change) / max(_power(seen), MIN_POWER))
            noise = 0.5 * mean_around(np.abs(change) ** 2, self._reach)
            pace = max(1.0 / self.cycles, MIN_NOISE_WEIGHT)
            self._noise = noise if np.isinf(self._noise[0]) else self._noise + pace * (noise - self._noise)
        weight = max(RECENT / (self.cycles + RECENT - 1.0), self._forgetting)
        self._mean = self._mean + weight * (seen - self._mean)
        self._share = np.array(weight**2 + (1.0 - weight) ** 2 * float(self._share))
        self._latest = seen

    def correct(self) -> bool:
        """Update the foreseen force from the mean; return whether there is any."""
        if np.isinf(self._noise[0]) or self.cycles == 0:
            return bool(np.any(self.spectrum))
        if self.change > MAX_CHANGE:
            self.spectrum = np.zeros_like(self.spectrum)
            self._tabulate(self.spectrum)
            return False
        power = np.maximum(mean_around(np.abs(self._mean) ** 2, self._reach), 1e-300)
        kept = np.clip(1.0 - NOISE_FACTOR * float(self._share) * self._noise / power, 0.0, 1.0)
        self.spectrum = self._passed * kept * self._mean
        self._tabulate(self.spectrum)
        return bool(np.any(self.spectrum))

    def expected(self) -> Array:
        """Return the repeating part of the force, shape (size,) [N]."""
        force: Array = np.fft.irfft(self._mean, self.size)
        return force

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> bool:
        """Restore arrays returned by :meth:`stored`; return whether they fit."""
        if not super().restore(stored):
            return False
        self.spectrum = np.where(self._passed > 0.0, self.spectrum, 0.0)
        self._tabulate(self.spectrum)
        return True


def _power(spectrum: Spectrum) -> float:
    """Return the sum of the squared amplitudes of all harmonics but the mean."""
    return float(np.sum(np.abs(spectrum[1:]) ** 2))
