"""Waveform of one cycle, reconstructed from its noisy samples.

A force that follows a reference equals the delayed and scaled reference up to smooth differences. The measured waveform is
therefore modelled as the reference, delayed and scaled according to its fundamental, plus the harmonics of the residual. The
corners of a triangle stay sharp, and noise causes no peaks.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.experiments.verification.sine_fit import Columns, basis

WRAPPED = 3
"""Number of samples by which the interpolation is continued periodically at each end."""

AROUND, FINER = 2, 8
"""Number of samples on either side of the largest one between which the extreme is searched, and steps per sample."""

BETWEEN = 0.041
"""Largest error of Akima's interpolation at the top of a sine, relative to its amplitude and the fourth power of the sample
spacing in radians; determined with 16 to 100 samples per cycle."""


class Waveform(NamedTuple):
    """A periodic curve.

    Attributes:
        curve: the reference over the position in the cycle.
        delay: delay of the curve [cycles].
        gain, offset: factor on the curve, and offset added then.
        harmonics: added terms: constant, then cosine and sine of each harmonic; shape (terms,).
        variance: variance of a sample's residual.
    """

    curve: "scipy.interpolate.Akima1DInterpolator"
    delay: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    harmonics: Array = np.zeros(1)
    variance: float = 0.0

    @classmethod
    def of(cls, at: Array, values: Array) -> "Waveform":
        """Return the curve through the samples of one cycle.

        Args:
            at: positions in the cycle, increasing over one cycle at most, shape (n,) [cycles].
            values: shape (n,).
        """
        place = at - math.floor(at[0] + 1e-9)
        x = np.concatenate([place[-WRAPPED:] - 1.0, place, place[:WRAPPED] + 1.0])
        # Akima's interpolation does not overshoot beside a step, unlike a cubic spline.
        return cls(scipy.interpolate.Akima1DInterpolator(x, np.concatenate([values[-WRAPPED:], values, values[:WRAPPED]])))

    def following(
        self, at: Array, force: Array, own: complex, asked: complex, mean: float, columns: Columns
    ) -> tuple["Waveform", Array]:
        """Return the waveform of a force that follows this waveform, and its values at the samples.

        Args:
            at: place in the cycle, shape (n,) [cycles].
            force: shape (n,).
            own: coefficient of the force's fundamental.
            asked: coefficient of this waveform's fundamental.
            mean: mean of this waveform.
            columns: columns of the fit at these positions.
        """
        ratio = own / asked if asked else 1.0
        gain, delay = abs(ratio), -float(np.angle(ratio)) / (2.0 * math.pi)
        bare = self._replace(delay=delay, gain=gain, offset=(1.0 - gain) * mean)
        base = bare.value(at)
        fit = columns.fit((force - base)[:, None])
        terms = np.concatenate([fit.mean, np.column_stack([fit.coefficient[0].real, -fit.coefficient[0].imag]).ravel()])
        return bare._replace(harmonics=terms, variance=float(fit.variance[0])), base + fit.fitted[:, 0]

    def value(self, at: Array) -> Array:
        """Return the values at positions in the cycle, shape (n,) [cycles]."""
        curve: Array = self.curve((at - self.delay) % 1.0)
        return self.offset + self.gain * curve + basis(at, len(self.harmonics) // 2) @ self.harmonics

    def extreme(self, at: Array, values: Array, sign: float) -> tuple[float, float]:
        """Return position [cycles] and value of the maximum, or of the minimum for a negative sign.

        Args:
            at: positions of the samples, shape (n,) [cycles].
            values: values of the waveform there, shape (n,).
            sign: 1 or -1.
        """
        best = at[int(np.argmax(sign * values))]
        reach = AROUND / len(at)
        near = best + np.linspace(-reach, reach, 2 * AROUND * FINER + 1)
        fine = self.value(near)
        index = int(np.argmax(sign * fine))
        return float(near[index]), float(fine[index])
