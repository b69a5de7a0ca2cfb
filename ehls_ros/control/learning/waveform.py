"""Learn a whole waveform, sample by sample.

Short errors, as at a reversal of the motion, are distinguished from noise where they occur, and little noise is learnt between
them.
"""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.learning.base import Learner
from ehls_ros.control.learning.robustness import Spectrum


class Waveform(Learner):
    """Correction by samples of the load cycle."""

    NEAR = 10
    AROUND = 100

    def coordinates(self, spectrum: Spectrum) -> Array:
        """Return the samples."""
        samples: Array = np.fft.irfft(spectrum, self.size)
        return samples

    def spectrum_of(self, coordinates: Array) -> Spectrum:
        """Return the spectrum of samples."""
        return np.fft.rfft(coordinates)

    def noise_per_harmonic(self, variance: float, harmonics: int) -> float:
        """Return the mean square of the noise's ``rfft`` at a harmonic, as all noise lies in the learnt harmonics."""
        return 0.5 * variance * self.size**2 / harmonics
