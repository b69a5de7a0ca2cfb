"""Learn harmonics of the load cycle: one complex number each, with its variance and that of the noise.

This is the usual method of test machines: the few numbers emerge quickly from noise, for errors as smooth as the motion.
"""

import numpy as np

from ehls_ros.control.learning.base import Coordinates, Learner
from ehls_ros.control.learning.robustness import Design, Spectrum


class Harmonics(Learner):
    """Correction by complex amplitudes of harmonics."""

    NEAR = 0
    AROUND = 3

    def __init__(self, design: Design, size: int, period: float, forgetting: float, count: int) -> None:
        """Start with no correction; ``count`` harmonics are learnt besides the mean, other arguments as of :class:`Learner`."""
        self.count = min(count, size // 2)
        super().__init__(design, size, period, forgetting)

    def coordinates(self, spectrum: Spectrum) -> Coordinates:
        """Return the amplitudes [N] of the mean and the harmonics."""
        return spectrum[: self.count + 1] * (2.0 / self.size)

    def spectrum_of(self, coordinates: Coordinates) -> Spectrum:
        """Return the spectrum of the amplitudes [N]."""
        spectrum = np.zeros(self.size // 2 + 1, dtype=np.complex128)
        spectrum[: self.count + 1] = coordinates * (0.5 * self.size)
        return spectrum

    def noise_per_harmonic(self, variance: float, harmonics: int) -> float:
        """Return the mean square of the noise's ``rfft`` at a harmonic."""
        return 0.25 * variance * self.size**2
