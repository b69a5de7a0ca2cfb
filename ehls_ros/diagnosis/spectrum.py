"""Spectral lines of a residual, used as starts for periodic disturbances and vibrations."""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules


def spectral_lines(e: Array, times: Array, count: int = rules.LINES) -> tuple[float, ...]:
    """Return the frequencies of the strongest lines in a residual's spectrum, strongest first [Hz].

    Args:
        e: whitened residuals, shape (n,).
        times: their times, shape (n,) [s].
        count: number of lines.
    """
    if len(e) < rules.LINE_SAMPLES:
        return ()
    step = float(np.median(np.diff(times)))
    even = np.interp(np.arange(times[0], times[-1], step), times, np.clip(e, -rules.LINE_CLIP, rules.LINE_CLIP))
    even = (even - even.mean()) * np.hanning(len(even))
    padded = rules.LINE_PADDING * len(even)
    spectrum = np.abs(np.fft.rfft(even, padded)) ** 2
    frequency = np.fft.rfftfreq(padded, step)
    spectrum[frequency < rules.LOWEST_LINE / (len(even) * step)] = 0.0
    found = []
    for _ in range(count):
        peak = int(np.argmax(spectrum))
        found.append(float(frequency[peak]))
        spectrum[np.abs(frequency - frequency[peak]) < rules.LINE_WIDTH / (len(even) * step)] = 0.0
    return tuple(found)
