"""Foresee the external force that repeats with the load cycle, as a preview for the law.

The smoothed force (:mod:`ehls_ros.control.learning.smoothing`) of a load cycle is d = x + n: x repeats, n does not. It does not
depend on the foreseen force, so that one load cycle shows all of x but the noise, and later ones only improve the mean. At each
harmonic the mean is multiplied by the gain of Wiener's filter,

    1 - V N / |mean|^2

with the variance N of n, from the differences of the force between successive load cycles, and its fraction V that remains in
the mean. N and |mean|^2 are averaged over :data:`ALIKE_WITHIN` on either side. A force that does not repeat is therefore hardly
foreseen.

Source: Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949, chapter 3.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.learning.averages import mean_around
from ehls_ros.control.learning.robustness import ROLL_OFF, Spectrum, falling

ALIKE_WITHIN = 2.0
"""Frequency on either side within which the noise is assumed constant [Hz]."""

DOUBT = 1.5
"""Safety factor on the noise expected in the mean."""

RECENT = 2.0
"""Weight of a load cycle relative to the mean of all: the first ones, without preview, moved the actuator differently."""

MOST_CHANGE = 0.3
"""Rms difference of the force between successive load cycles, over the rms of its alternating part, above which it is not
foreseen: a law with a foreseen force follows any other force less closely."""

LEAST_NEWS = 0.1
"""Least weight of one load cycle in the noise's variance."""


LEAST_POWER = 1e-12
"""Lower bound of a sum of squared amplitudes, for a force that never acts."""


class Foresight:
    """Estimate of the repeating force and its certainty.

    Attributes:
        size: samples of the load cycle.
        cycles: number of load cycles used.
        change: rms difference between the last two load cycles, over the rms of the force's alternating part.
        spectrum: the foreseen force as an ``rfft``.
        table: that force and its two derivatives at the samples, the first again at the end, shape (size + 1, 3).
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
        self.size, self.cycles = size, 0
        self._forgetting = forgetting
        harmonics = np.arange(size // 2 + 1)
        self._turning = 2j * math.pi / period * harmonics
        # The highest harmonic of an even number of samples has no phase, and so no derivative.
        self._turning[-1] *= size % 2
        edge = max(bandwidth, 1.0 / period)
        self._passed = falling(harmonics / period, edge, ROLL_OFF * edge)
        self._reach = max(1, round(ALIKE_WITHIN * period))
        nothing: Spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
        self.spectrum = self._mean = self._latest = nothing
        self._noise = np.full(size // 2 + 1, np.inf)
        self._share = np.array(0.0)
        self.change = 0.0
        self.table = np.zeros((size + 1, 3))

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
            self.change = math.sqrt(_power(change) / max(_power(seen), LEAST_POWER))
            noise = 0.5 * mean_around(np.abs(change) ** 2, self._reach)
            news = max(1.0 / self.cycles, LEAST_NEWS)
            self._noise = noise if np.isinf(self._noise[0]) else self._noise + news * (noise - self._noise)
        weight = max(RECENT / (self.cycles + RECENT - 1.0), self._forgetting)
        self._mean = self._mean + weight * (seen - self._mean)
        self._share = np.array(weight**2 + (1.0 - weight) ** 2 * float(self._share))
        self._latest = seen

    def correct(self) -> bool:
        """Update the foreseen force from the mean; return whether there is any."""
        if np.isinf(self._noise[0]) or self.cycles == 0:
            return bool(np.any(self.spectrum))
        if self.change > MOST_CHANGE:
            self.spectrum = np.zeros_like(self.spectrum)
            self.tabulate()
            return False
        power = np.maximum(mean_around(np.abs(self._mean) ** 2, self._reach), 1e-300)
        kept = np.clip(1.0 - DOUBT * float(self._share) * self._noise / power, 0.0, 1.0)
        self.spectrum = self._passed * kept * self._mean
        self.tabulate()
        return bool(np.any(self.spectrum))

    def tabulate(self) -> None:
        """Fill the table from the spectrum."""
        for column in range(3):
            self.table[:-1, column] = np.fft.irfft(self._turning**column * self.spectrum, self.size)
        self.table[-1] = self.table[0]

    def expected(self) -> Array:
        """Return the repeating part of the force, shape (size,) [N]."""
        force: Array = np.fft.irfft(self._mean, self.size)
        return force

    def stored(self) -> dict[str, NDArray[Any]]:
        """Return the learnt arrays, by name."""
        return {"cycles": np.array(self.cycles), **{name.strip("_"): getattr(self, name) for name in self.STORED}}

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> bool:
        """Restore arrays returned by :meth:`stored`; return whether they fit."""
        values = {name: stored.get(name.strip("_")) for name in self.STORED}
        if any(value is None or value.shape != getattr(self, name).shape for name, value in values.items()):
            return False
        for name, value in values.items():
            setattr(self, name, value)
        self.spectrum = np.where(self._passed > 0.0, self.spectrum, 0.0)
        self.cycles = int(stored["cycles"])
        self.tabulate()
        return True


def _power(spectrum: Spectrum) -> float:
    """Return the sum of the squared amplitudes of all harmonics but the mean."""
    return float(np.sum(np.abs(spectrum[1:]) ** 2))
