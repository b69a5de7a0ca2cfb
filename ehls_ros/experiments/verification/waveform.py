"""The waveform of one cycle between and beyond its noisy samples.

A force that follows a reference looks like it, somewhat later and of another size, with smooth differences. So the measured
waveform is the reference, delayed and scaled as its fundamental is, plus the harmonics of what remains: the corners of a
triangle stay sharp, and noise makes no peaks.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.experiments.verification.sine_fit import Columns, basis

WRAPPED = 3
"""Samples of the other end of the cycle that its interpolation is continued with."""

AROUND, FINER = 2, 8
"""Samples on either side of the largest one between which the extreme is looked for, and steps per sample there."""

BETWEEN = 0.041
"""Largest error of Akima's interpolation at the top of a sine, over its amplitude and the fourth power of the samples' spacing
in radians; found with 16 to 100 samples a cycle."""


class Waveform(NamedTuple):
    """A periodic curve.

    Attributes:
        curve: the reference by the place in the cycle.
        delay: by how much it comes later [cycles].
        gain, offset: by which it is multiplied, and what is added then.
        harmonics: what is added to it: constant, then cosine and sine of each harmonic; shape (terms,).
        variance: of a sample's residual.
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
            at: place in the cycle, increasing over one cycle at most, shape (n,) [cycles].
            values: shape (n,).
        """
        place = at - math.floor(at[0] + 1e-9)
        x = np.concatenate([place[-WRAPPED:] - 1.0, place, place[:WRAPPED] + 1.0])
        # Akima's does not overshoot beside a step, as a cubic spline would.
        return cls(scipy.interpolate.Akima1DInterpolator(x, np.concatenate([values[-WRAPPED:], values, values[:WRAPPED]])))

    def following(
        self, at: Array, force: Array, own: complex, asked: complex, mean: float, columns: Columns
    ) -> tuple["Waveform", Array]:
        """Return the waveform of a force that follows this one, and its values at the samples.

        Args:
            at: place in the cycle, shape (n,) [cycles].
            force: shape (n,).
            own: coefficient of the force's fundamental.
            asked: of this one's.
            mean: of this one.
            columns: of the fit at these places.
        """
        ratio = own / asked if asked else 1.0
        gain, delay = abs(ratio), -float(np.angle(ratio)) / (2.0 * math.pi)
        bare = self._replace(delay=delay, gain=gain, offset=(1.0 - gain) * mean)
        base = bare.value(at)
        fit = columns.fit((force - base)[:, None])
        terms = np.concatenate([fit.mean, np.column_stack([fit.coefficient[0].real, -fit.coefficient[0].imag]).ravel()])
        return bare._replace(harmonics=terms, variance=float(fit.variance[0])), base + fit.fitted[:, 0]

    def value(self, at: Array) -> Array:
        """Return the values at places in the cycle, shape (n,) [cycles]."""
        curve: Array = self.curve((at - self.delay) % 1.0)
        return self.offset + self.gain * curve + basis(at, len(self.harmonics) // 2) @ self.harmonics

    def extreme(self, at: Array, values: Array, sign: float) -> tuple[float, float]:
        """Return place [cycles] and value of the largest value, of the smallest for a negative sign.

        Args:
            at: places of the samples, shape (n,) [cycles].
            values: of the waveform there, shape (n,).
            sign: 1 or -1.
        """
        best = at[int(np.argmax(sign * values))]
        reach = AROUND / len(at)
        near = best + np.linspace(-reach, reach, 2 * AROUND * FINER + 1)
        fine = self.value(near)
        index = int(np.argmax(sign * fine))
        return float(near[index]), float(fine[index])
