"""Response of a force to a reference that does not repeat: gain, lag and coherence over frequency.

Both signals are tapered as a whole, and their spectra averaged over neighbouring frequencies (Bendat and Piersol, Random Data,
2010, ch. 11). The mean delay is removed before: otherwise the phase turns within a band, and the average is too small.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array

MIN_SAMPLES, MIN_LINES = 64, 12
"""Least number of samples of a response, and of spectral lines averaged. Noise alone has a coherence of about 1.5 over the
number of lines."""

MAX_BANDS = 5
"""Maximum number of bands."""

LEFT_OUT = 5e-3
"""Fraction of the reference's power below the lowest band, and above the highest."""

POINTS, WIDTH = 80, 1.1
"""Number of points of the curves, and the ratio of frequencies over which each is averaged to either side."""

STILL = 1e-6
"""Rms of a reference about a straight line, as a fraction of its largest value, below which it does not move."""


class Band(NamedTuple):
    """Response in a band of frequency.

    Attributes:
        low_hz, high_hz: the band [Hz].
        reference_rms_n: rms of the reference in it [N].
        error_rms_n: rms of measured less reference in it [N].
        gain: ratio of the force to the reference.
        lag_s: lag of the force [s].
        phase_deg: phase of the force at the band's mean frequency [deg]; negative for a lag.
        coherence: fraction of the force's power that follows the reference linearly, 0 to 1.
    """

    low_hz: float
    high_hz: float
    reference_rms_n: float
    error_rms_n: float
    gain: float
    lag_s: float
    phase_deg: float
    coherence: float


@dataclass(frozen=True)
class Response:
    """Response over frequency.

    Attributes:
        bands: the response in bands.
        frequency: frequencies of the curves, shape (n,) [Hz].
        gain, lag_s, coherence: the curves, shape (n,).
    """

    bands: tuple[Band, ...]
    frequency: Array
    gain: Array
    lag_s: Array
    coherence: Array


def response_of(time: Array, reference: Array, force: Array) -> Response | None:
    """Return the response of a force to its reference.

    Args:
        time: shape (n,) [s], increasing.
        reference: shape (n,) [N]; NaN where missing.
        force: likewise.

    Returns:
        The response; None if the reference moves along a straight line at most, or is too short.
    """
    known = np.isfinite(reference) & np.isfinite(force)
    if int(known.sum()) < MIN_SAMPLES:
        return None
    time, reference, force = time[known], reference[known], force[known]
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    x, y = (scipy.signal.detrend(np.interp(even, time, values)) for values in (reference, force))
    if len(even) < MIN_SAMPLES or math.sqrt(float(np.mean(x**2))) <= STILL * float(np.abs(reference).max()):
        return None
    spectra = _spectra(x, y, step)
    within = np.cumsum(spectra.reference) / np.sum(spectra.reference)
    low, high = (int(np.searchsorted(within, part)) for part in (LEFT_OUT, 1.0 - LEFT_OUT))
    low = max(low, 1)
    high = min(max(high + 1, low + MIN_LINES), len(within))
    count = int(np.clip(round(math.log2(high / low)), 1, MAX_BANDS))
    edges = [low]
    for edge in np.geomspace(low, high, count + 1)[1:]:
        if round(edge) - edges[-1] >= MIN_LINES:
            edges.append(round(edge))
    edges[-1] = high
    edges = edges if len(edges) > 1 else [low, high]
    bands = tuple(spectra.band(begin, end) for begin, end in pairwise(edges))
    centres = np.geomspace(low, high - 1, POINTS)
    half = np.maximum(centres * (WIDTH - 1.0), 0.5 * MIN_LINES)
    begins = np.clip(np.rint(centres - half), 1, len(within) - 1).astype(np.intp)
    ends = np.clip(np.rint(centres + half) + 1, 1, len(within)).astype(np.intp)
    curve = [spectra.band(int(begin), int(end)) for begin, end in zip(begins, ends, strict=True)]
    return Response(
        bands=bands,
        frequency=centres * spectra.spacing,
        gain=np.array([band.gain for band in curve]),
        lag_s=np.array([band.lag_s for band in curve]),
        coherence=np.array([band.coherence for band in curve]),
    )


class _Spectra(NamedTuple):
    """Spectra of reference and force, the force without the mean delay.

    Attributes:
        spacing: distance of the lines [Hz].
        delay: the mean delay [s].
        reference, force, error: power of each line [N^2].
        cross: their cross-spectrum.
    """

    spacing: float
    delay: float
    reference: Array
    force: Array
    error: Array
    cross: NDArray[np.complex128]

    def band(self, begin: int, end: int) -> Band:
        """Return the response averaged over lines."""
        x, y, error = (float(power[begin:end].sum()) for power in (self.reference, self.force, self.error))
        cross = complex(self.cross[begin:end].sum())
        tiny = float(np.finfo(float).tiny)
        middle = float(np.arange(begin, end) @ self.reference[begin:end]) / max(x, tiny) * self.spacing
        lag = self.delay - math.atan2(cross.imag, cross.real) / (2.0 * math.pi * max(middle, tiny))
        return Band(
            low_hz=begin * self.spacing,
            high_hz=end * self.spacing,
            reference_rms_n=math.sqrt(x),
            error_rms_n=math.sqrt(error),
            gain=abs(cross) / max(x, tiny),
            lag_s=lag,
            phase_deg=-360.0 * middle * lag,
            coherence=min(1.0, abs(cross) ** 2 / max(x * y, tiny)),
        )


def _spectra(x: Array, y: Array, step: float) -> _Spectra:
    count = len(x)
    taper = scipy.signal.windows.hann(count, sym=False)
    size = scipy.fft.next_fast_len(2 * count, real=True)
    shared = scipy.fft.irfft(scipy.fft.rfft(y * taper, size) * np.conj(scipy.fft.rfft(x * taper, size)), size)
    most = count // 4
    lags = np.concatenate([shared[: most + 1], shared[-most:]])
    best = int(np.argmax(lags))
    delay = (best if best <= most else best - len(lags)) * step
    of_x, of_y = np.fft.rfft(x * taper), np.fft.rfft(y * taper)
    spacing = 1.0 / (count * step)
    turned = of_y * np.exp(2j * np.pi * spacing * delay * np.arange(len(of_y)))
    # Mean squares of the signals, which the taper lowers.
    scale = 2.0 / (count * float(np.sum(taper**2)))
    reference, force, error = (scale * np.abs(values) ** 2 for values in (of_x, of_y, of_y - of_x))
    return _Spectra(spacing, delay, reference, force, error, scale * turned * np.conj(of_x))
