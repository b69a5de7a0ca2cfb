"""Blocks of a recording, and the position of every sample in the load cycle.

Both follow from the signals of a programme. Without a programme, the recording is one block with the cycle of its reference.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.experiments.verification.sine_fit import Sine, fit_sine
from ehls_ros.trajectory import Trajectory

BLOCK, REPETITION, PHASE = "programme_block", "programme_repetition", "programme_phase"
"""Signals of a test programme: number of the block, load cycles completed in its present pass, phase in the cycle (0 to 1)."""

MAX_SEARCHED = 2**16
"""Maximum number of samples searched for a period."""

MIN_CYCLES = 3
"""Minimum number of cycles of a periodic signal."""

DIP = 0.02
"""Normalised difference of a signal from itself one period later up to which it is periodic."""

STARTS = ("frequency", "base_frequency")
"""Parameters of a reference with the frequency of its cycle."""


class Stretch(NamedTuple):
    """Consecutive samples of a block.

    Attributes:
        samples: slice of the recording.
        position: load cycles completed, with fraction, shape (n,) [cycles]; NaN for a non-periodic reference.
    """

    samples: slice
    position: Array


class Block(NamedTuple):
    """A part of a test with the same cycle throughout.

    Attributes:
        number: number in the programme; None for a whole recording.
        stretches: its stretches; several if it was repeated or interrupted.
    """

    number: int | None
    stretches: tuple[Stretch, ...]

    @property
    def name(self) -> str:
        """Name in reports."""
        return "whole recording" if self.number is None else f"block {self.number}"


def blocks_of(run: Trajectory) -> tuple[Block, ...]:
    """Return the blocks of a recording in the order of their first samples.

    Args:
        run: the recording, with ``force_reference_n``.
    """
    number = run.signals.get(BLOCK)
    if number is None or not np.isfinite(number).any():
        return (Block(None, (_stretch(run, slice(0, len(run)), counted=False),)),)
    counted = PHASE in run and REPETITION in run
    found: dict[int, list[Stretch]] = {}
    for value, samples in _runs(number):
        found.setdefault(value, []).extend(_passes(_stretch(run, samples, counted=counted)))
    return tuple(Block(value, tuple(stretches)) for value, stretches in found.items())


def _runs(number: Array) -> Iterator[tuple[int, slice]]:
    """Yield the parts of one number each; samples without a number within a part belong to it."""
    known = np.flatnonzero(np.isfinite(number))
    values = np.rint(number[known]).astype(np.int64)
    ends = np.flatnonzero(np.diff(values)) + 1
    for part in np.split(np.arange(len(known)), ends):
        yield int(values[part[0]]), slice(int(known[part[0]]), int(known[part[-1]]) + 1)


def _stretch(run: Trajectory, samples: slice, *, counted: bool) -> Stretch:
    time, reference = run.time_s[samples], run["force_reference_n"][samples]
    if counted:
        position = run[REPETITION][samples] + run[PHASE][samples]
        if np.isfinite(position).any():
            return Stretch(samples, position)
    found = cycle_of(time, reference, run.metadata)
    if found is None:
        return Stretch(samples, np.full(len(time), np.nan))
    begin = time[np.flatnonzero(np.isfinite(reference))[0]]
    # A cycle begins where the fundamental rises through the mean.
    rise = (np.angle(found.coefficient) + 0.5 * np.pi) / (2.0 * np.pi)
    return Stretch(samples, found.frequency * (time - begin) + rise % 1.0)


def _passes(stretch: Stretch) -> Iterator[Stretch]:
    """Split a stretch where the cycle count restarts."""
    known = np.flatnonzero(np.isfinite(stretch.position))
    back = known[1:][np.diff(stretch.position[known]) < -0.5]
    begin = stretch.samples.start
    edges = [0, *back.tolist(), len(stretch.position)]
    for low, high in pairwise(edges):
        yield Stretch(slice(begin + low, begin + high), stretch.position[low:high])


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
    if len(time) < 4 * MIN_CYCLES or np.ptp(reference) <= 1e-9 * np.abs(reference).max():
        return None
    step = float(np.median(np.diff(time)))
    duration = float(time[-1] - time[0])
    even = np.interp(time[0] + np.arange(round(duration / step) + 1) * step, time, reference)
    begin = max(0, (len(even) - MAX_SEARCHED) // 2)
    given = _reference_frequency(metadata)
    frequency = None
    if given is not None and MIN_CYCLES / duration <= given <= 0.25 / step and _repeats(even, round(1.0 / (given * step))):
        frequency = given
    stride = -(-len(even) // MAX_SEARCHED)
    frequency = frequency or _first_dip(even[begin : begin + MAX_SEARCHED], step)
    if frequency is None and stride > 1:
        frequency = _first_dip(even[::stride], step * stride)
    return None if frequency is None else fit_sine(time, reference, frequency)


def _reference_frequency(metadata: Mapping[str, Any]) -> float | None:
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
    lags = len(centred) // MIN_CYCLES
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
