"""Frequency of a periodic reference."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.experiments.verification.sine_fit import Sine, fit_sine

LONGEST = 2**16
"""Maximum number of samples searched for a period."""

FEWEST = 3
"""Minimum number of cycles of a periodic signal."""

DIP = 0.02
"""Normalised difference of a signal from itself one period later up to which it is periodic."""

STARTS = ("frequency", "base_frequency")
"""Parameters of a reference with the frequency of its cycle."""


def cycle_of(time: Array, reference: Array, metadata: Mapping[str, Any]) -> Sine | None:
    """Return the fundamental of a periodic reference; None if it is not periodic.

    The search starts from the frequency of the experiment's reference if it is known and fits, otherwise from the first dip of
    the normalised difference function.

    Args:
        time: times, shape (n,) [s], increasing.
        reference: reference, shape (n,), NaN where missing.
        metadata: metadata of the recording.

    Returns:
        The sine, with time from the first finite sample.

    Source: A. de Cheveigné and H. Kawahara, "YIN, a fundamental frequency estimator for speech and music", J. Acoust. Soc. Am.
    111 (2002), for the difference function; IEEE Std 1057 for the fit.
    """
    known = np.isfinite(reference)
    time, reference = time[known], reference[known]
    if len(time) < 4 * FEWEST or np.ptp(reference) <= 1e-9 * np.abs(reference).max():
        return None
    step = float(np.median(np.diff(time)))
    duration = float(time[-1] - time[0])
    even = np.interp(time[0] + np.arange(round(duration / step) + 1) * step, time, reference)
    begin = max(0, (len(even) - LONGEST) // 2)
    told = _told(metadata)
    frequency = None
    if told is not None and FEWEST / duration <= told <= 0.25 / step and _repeats(even, round(1.0 / (told * step))):
        frequency = told
    stride = -(-len(even) // LONGEST)
    frequency = frequency or _first_dip(even[begin : begin + LONGEST], step)
    if frequency is None and stride > 1:
        frequency = _first_dip(even[::stride], step * stride)
    return None if frequency is None else fit_sine(time, reference, frequency)


def _told(metadata: Mapping[str, Any]) -> float | None:
    value: object = metadata.get("spec")
    value = value.get("reference") if isinstance(value, Mapping) else None
    for key in STARTS:
        found = value.get(key) if isinstance(value, Mapping) else None
        if isinstance(found, int | float) and not isinstance(found, bool) and found > 0.0:
            return float(found)
    return None


def _repeats(signal: Array, lag: int) -> bool:
    difference = float(np.mean((signal[lag:] - signal[:-lag]) ** 2))
    return difference <= 2.0 * DIP * float(np.var(signal))


def _first_dip(signal: Array, step: float) -> float | None:
    """Return the frequency [Hz] of the first dip of the cumulative mean normalised difference function."""
    centred = signal - signal.mean()
    lags = len(centred) // FEWEST
    window = len(centred) - lags
    energy = np.concatenate([[0.0], np.cumsum(centred**2)])
    moved = energy[window : window + lags + 1] - energy[: lags + 1]
    product = scipy.signal.correlate(centred, centred[:window], mode="valid", method="fft")
    difference = np.maximum(energy[window] + moved - 2.0 * product, 0.0)
    total = np.cumsum(difference[1:])
    if not total[-1] > 0.0:
        return None
    normalised = np.concatenate([[1.0], difference[1:] * np.arange(1, lags + 1) / np.maximum(total, np.finfo(float).tiny)])
    low = np.flatnonzero(normalised <= DIP)
    if not low.size:
        return None
    at = int(low[0])
    while at < lags and normalised[at + 1] < normalised[at]:
        at += 1
    if at >= lags:
        return None
    before, here, after = normalised[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    return 1.0 / (step * (at + (0.5 * (before - after) / bend if bend > 0.0 else 0.0)))
