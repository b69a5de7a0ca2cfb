"""Iterative learning of a correction from load cycle to load cycle, by samples or by harmonics.

An error that repeats with the load cycle is e = x + n: x repeats, n is new in each cycle. x is estimated from all cycles by a
Kalman filter with one variance per coordinate. Coordinates are the cycle's samples or its harmonics. The variance R of n is
learnt from the differences between cycles. The variance P of x follows from R, from the number of cycles, and from the
uncertainty of a correction's effect. Possible noise is not corrected: only the part of x that exceeds its standard deviation is
used, which is unknown before two cycles have shown the repeating part. The noise in a correction therefore falls with the
number of cycles n as n^-1/2, to the bound set by the forgetting.

A correction dc changes x by T dc, with T0 and W from :mod:`ehls_ros.control.learning.robustness`: x := x + T0 dc,
P := P + |W T0 dc|^2.

Source: Anderson, Moore, Optimal Filtering, 1979, section 3.1; fading memory, section 6.2; the repeated correction as in
Bristow, Tharayil, Alleyne, A survey of iterative learning control, IEEE Control Systems Magazine 26, 2006.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.learning.periodic import PeriodicSignal, mean_around
from ehls_ros.control.learning.robustness import Design, Spectrum

MIN_SIGNIFICANCE, FULL_SIGNIFICANCE = 2.0, 4.0
"""Squared error over its variance up to which nothing is corrected, and from which all of it is."""

MIN_VARIANCE = 1e-12
"""Lower bound of a variance [N^2], as noise-free simulations repeat exactly."""

TRANSITION = 4.0
"""Largest accepted variance of the noise, relative to its median, after a load cycle with a transition."""

SMOOTH = 1.0
"""Frequency on either side within which the response is assumed constant [Hz]."""

PACE = 0.3
"""Weight of one load cycle in the noise's variance."""

REMEMBERED = 0.7
"""Fraction of the evidence on the response that is kept over a load cycle."""

MIN_UNCERTAINTY = 0.1
"""Least uncertainty of a response after many observations."""

Coordinates = NDArray[Any]
"""A signal over a load cycle: its samples, or complex amplitudes of its harmonics."""


class Corrector(PeriodicSignal, ABC):
    """Learnt correction of a reference."""

    @abstractmethod
    def observe(self, error: Array, *, settled: bool = True) -> None:
        """Process the error of one load cycle, under the present correction.

        Args:
            error: error [N], shape (size,).
            settled: whether it repeats; False for a load cycle with a transition.
        """

    @abstractmethod
    def correct(self) -> bool:
        """Update the correction; return whether there is any."""

    @abstractmethod
    def start_over(self) -> None:
        """Re-estimate the error from the next load cycles, as the response of the law has changed."""

    @abstractmethod
    def without(self) -> Array:
        """Return the expected error without any correction, filtered as by :meth:`kept` [N]."""

    @abstractmethod
    def kept(self, error: Array) -> Array:
        """Return the part of an error that is considered [N]."""

    @abstractmethod
    def report(self) -> Mapping[str, float | str]:
        """Return figures for diagnostics."""


class Learner(Corrector):
    """Correction without a given shape, learnt in some coordinates.

    Attributes:
        design: filters of the learning.
        spectrum: the correction as an ``rfft``.
    """

    NEAR: int
    """Coordinates on either side over which the significance is averaged."""

    AROUND: int
    """Coordinates on either side over which the noise's variance is averaged."""

    STORED = ("spectrum", "_estimate", "_variance", "_noise", "_response", "_doubt", "_cross", "_power")

    def __init__(self, design: Design, size: int, period: float, forgetting: float) -> None:
        """Start with no correction.

        Args:
            design: filters at the harmonics of the load cycle.
            size: samples of the load cycle.
            period: length of the load cycle [s].
            forgetting: fraction of the knowledge that is lost per load cycle.
        """
        super().__init__(size, period)
        self.design = design
        self._forgetting = forgetting
        self._estimate_is_of: bool | None = None
        self._noise_is_settled = False
        self.spectrum: Spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
        self._response, self._doubt = design.response, design.uncertainty
        self._pool = max(1, round(SMOOTH * period))
        self._cross: Spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
        self._power = np.zeros(size // 2 + 1)
        self._change: Spectrum | None = None
        self._error: Spectrum = self.spectrum
        self._estimate: Coordinates = self.coordinates(self.spectrum)
        self._variance = np.full(self._estimate.shape, np.inf)
        self._noise = np.full(self._estimate.shape, np.inf)

    @abstractmethod
    def coordinates(self, spectrum: Spectrum) -> Coordinates:
        """Return a spectrum in the coordinates of the learning."""

    @abstractmethod
    def spectrum_of(self, coordinates: Coordinates) -> Spectrum:
        """Return the spectrum of coordinates."""

    @abstractmethod
    def noise_per_harmonic(self, variance: float, harmonics: int) -> float:
        """Return the mean square of the noise's ``rfft`` per harmonic, from its variance and the number of harmonics."""

    def observe(self, error: Array, *, settled: bool = True) -> None:
        """Process the error of one load cycle, under the present correction.

        Args:
            error: error [N], shape (size,).
            settled: whether it repeats; of a cycle with a transition, only the part confirmed by the next cycle is used.
        """
        spectrum = self.design.robustness * np.fft.rfft(error)
        seen = self.coordinates(spectrum)
        self.cycles += settled
        if self.cycles == 0 or not np.any(np.isfinite(self._noise)):
            self._first(seen, settled=settled)
        else:
            self._compare(spectrum - self._error)
            self._follow(seen)
        self._error, self._change = spectrum, None

    def _first(self, seen: Coordinates, *, settled: bool) -> None:
        """Start with a load cycle, or estimate the noise from the second."""
        if self._estimate_is_of is None:
            self._estimate, self._estimate_is_of = seen, settled
            return
        missed = seen - self._estimate
        noise = 0.5 * mean_around(np.abs(missed) ** 2, self.AROUND)
        if self._estimate_is_of:
            self._estimate = self._estimate + 0.5 * missed
            self._noise = np.maximum(noise, MIN_VARIANCE)
            self._noise_is_settled = True
            self._variance = 0.5 * self._noise
        else:
            # The part of the difference due to the transition is not noise.
            self._estimate = seen
            self._noise = np.maximum(np.minimum(noise, TRANSITION * float(np.median(noise))), MIN_VARIANCE)
            self._variance = self._noise.copy()

    def _compare(self, difference: Spectrum) -> None:
        """Learn the response and the noise from the change of the error since the previous load cycle."""
        if self._change is not None:
            before = self._response
            self._identify(difference, self._change)
            self._estimate = self._estimate + self.coordinates((self._response - before) * self._change)
            difference = difference - self._response * self._change
        noise = 0.5 * mean_around(np.abs(self.coordinates(difference)) ** 2, self.AROUND)
        pace = PACE if self._noise_is_settled else 1.0
        self._noise = np.maximum(self._noise + pace * (noise - self._noise), MIN_VARIANCE)
        self._noise_is_settled = True

    def _follow(self, seen: Coordinates) -> None:
        """Update the estimate by one more load cycle."""
        missed = seen - self._estimate
        self._variance = self._variance / (1.0 - self._forgetting)
        weight = self._variance / (self._variance + self._noise)
        self._estimate = self._estimate + weight * missed
        self._variance = self._variance * (1.0 - weight)

    def _identify(self, difference: Spectrum, change: Spectrum) -> None:
        """Learn the response from the effect of a change of the correction.

        The response is assumed constant within :data:`SMOOTH`. The prior response has the weight given by its uncertainty
        relative to the noise.
        """
        design = self.design
        learnt = design.robustness > 0.0
        self._cross = REMEMBERED * self._cross + mean_around(difference * np.conj(change), self._pool)
        self._power = REMEMBERED * self._power + mean_around(np.abs(change) ** 2, self._pool)
        # For the difference of two cycles, per harmonic in the band that is learnt.
        noise = 2.0 * self.noise_per_harmonic(float(np.mean(self._noise)), max(int(np.sum(learnt)), 1))
        prior = noise / np.maximum(np.abs(design.uncertainty * design.response) ** 2, 1e-12)
        total = np.maximum(prior + (2 * self._pool + 1) * self._power, 1e-300)
        cross = (2 * self._pool + 1) * self._cross
        self._response = (prior * design.response + cross) / total
        left = np.sqrt(noise / total) / np.maximum(np.abs(self._response), 1e-12)
        self._doubt = np.clip(left, MIN_UNCERTAINTY, design.uncertainty)

    def correct(self) -> bool:
        """Update the correction by the significant part of the error; return whether there is any correction."""
        if not np.any(np.isfinite(self._noise)):
            return bool(np.any(self.spectrum))
        size = np.maximum(mean_around(np.abs(self._estimate) ** 2, self.NEAR), MIN_VARIANCE)
        certainty = size / np.maximum(mean_around(self._variance, self.NEAR), MIN_VARIANCE)
        kept = np.clip((certainty - MIN_SIGNIFICANCE) / (FULL_SIGNIFICANCE - MIN_SIGNIFICANCE), 0.0, 1.0)
        inverse = self.design.inverse(self._response, self._doubt)
        change = -self.design.robustness * inverse * self.spectrum_of(kept * self._estimate)
        effect = self._response * change
        self._estimate = self._estimate + self.coordinates(effect)
        doubt = np.abs(self.coordinates(self._doubt * effect)) ** 2
        self._variance = self._variance + mean_around(doubt, self.NEAR)
        self.spectrum, self._change = self.spectrum + change, change
        self._tabulate(self.spectrum)
        return bool(np.any(self.spectrum))

    def start_over(self) -> None:
        """Re-estimate error and noise from the next load cycles, as the response of the law has changed."""
        self._noise = np.full(self._estimate.shape, np.inf)
        self._estimate_is_of, self._noise_is_settled = None, False
        self._change = None

    def without(self) -> Array:
        """Return the expected repeating error without any correction, shape (size,) [N]."""
        expected: Array = np.fft.irfft(self.spectrum_of(self._estimate) - self._response * self.spectrum, self.size)
        return expected

    def kept(self, error: Array) -> Array:
        """Return the part of an error within the learning bandwidth, shape (size,) [N]."""
        part: Array = np.fft.irfft(self.design.robustness * np.fft.rfft(error), self.size)
        return part

    def report(self) -> Mapping[str, float | str]:
        """Return the designed and the worst-case convergence rate, and the bandwidth."""
        filters = self.design
        return {"designed_rate": filters.rate, "worst_rate": filters.worst, "bandwidth_hz": filters.bandwidth}

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> bool:
        """Restore arrays returned by :meth:`stored`; return whether they fit."""
        if not super().restore(stored):
            return False
        # Nothing is learnt beyond the band.
        self.spectrum = np.where(self.design.robustness > 0.0, self.spectrum, 0.0)
        self._tabulate(self.spectrum)
        return True


class Waveform(Learner):
    """Correction by samples of the load cycle.

    Short errors, as at a reversal of the motion, are distinguished from noise where they occur. Little noise is learnt between
    them.
    """

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


class Harmonics(Learner):
    """Correction by complex amplitudes of harmonics.

    This is the usual method of test machines: the few numbers emerge quickly from noise, for errors as smooth as the motion.
    """

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
