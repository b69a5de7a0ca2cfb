"""Learns a whole waveform, sample by sample.

Errors that are short, as at a reversal of the motion, are told from noise where they occur, and little noise is learnt between
them.
"""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.learning.base import Learner
from ehls_ros.control.learning.robustness import Spectrum


class Waveform(Learner):
    """A correction by samples of the load cycle."""

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
        """Return the mean square of a harmonic, as all of the noise lies in those that are learnt."""
        return 0.5 * variance * self.size**2 / harmonics
