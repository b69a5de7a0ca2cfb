"""Blocks of a recording, and the position of every sample in the load cycle.

Both follow from the signals of a programme. Without a programme, the recording is one block with the cycle of its reference,
and its stretches are the parts in which the reference repeats: a hold, a taper or a tail belongs to none of them.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

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

HALVINGS = 5
"""Number of times the reference is halved in the search for a part that repeats."""

STEPS_PER_CYCLE, MAX_STEPS = 16, 2**15
"""Number of places per cycle at which the level of a cycle is compared, and their maximum number."""

SAME_LEVEL = 0.01
"""Difference in mean, rms and fundamental up to which two cycles have the same level, as a fraction of the amplitude; with few
samples per cycle, the error of their sums is added."""

MOVING = 0.02
"""Fraction of the largest rms of a cycle from which the reference moves."""

MIN_PART, MAX_OTHER = 0.2, 0.2
"""Least fraction of the moving reference that repeats, for the parts to be judged; and the largest fraction of other cycles
within a part."""


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
        return (Block(None, _stretches(run, slice(0, len(run)), counted=False)),)
    counted = PHASE in run and REPETITION in run
    found: dict[int, list[Stretch]] = {}
    for value, samples in _runs(number):
        for stretch in _stretches(run, samples, counted=counted):
            found.setdefault(value, []).extend(_passes(stretch))
    return tuple(Block(value, tuple(stretches)) for value, stretches in found.items())


def _runs(number: Array) -> Iterator[tuple[int, slice]]:
    """Yield the parts of one number each; samples without a number within a part belong to it."""
    known = np.flatnonzero(np.isfinite(number))
    values = np.rint(number[known]).astype(np.int64)
    ends = np.flatnonzero(np.diff(values)) + 1
    for part in np.split(np.arange(len(known)), ends):
        yield int(values[part[0]]), slice(int(known[part[0]]), int(known[part[-1]]) + 1)


def _stretches(run: Trajectory, samples: slice, *, counted: bool) -> tuple[Stretch, ...]:
    time, reference = run.time_s[samples], run["force_reference_n"][samples]
    if counted:
        position = run[REPETITION][samples] + run[PHASE][samples]
        if np.isfinite(position).any():
            return (Stretch(samples, position),)
    return tuple(
        Stretch(slice(samples.start + part.start, samples.start + part.stop), _position(time[part], reference[part], found))
        for part, found in repeating_parts(time, reference, run.metadata)
    ) or (Stretch(samples, np.full(len(time), np.nan)),)


def _position(time: Array, reference: Array, found: Sine) -> Array:
    begin = time[np.flatnonzero(np.isfinite(reference))[0]]
    # A cycle begins where the fundamental rises through the mean.
    rise = (np.angle(found.coefficient) + 0.5 * np.pi) / (2.0 * np.pi)
    position: Array = found.frequency * (time - begin) + rise % 1.0
    return position


def _passes(stretch: Stretch) -> Iterator[Stretch]:
    """Split a stretch where the cycle count restarts."""
    known = np.flatnonzero(np.isfinite(stretch.position))
    back = known[1:][np.diff(stretch.position[known]) < -0.5]
    begin = stretch.samples.start
    edges = [0, *back.tolist(), len(stretch.position)]
    for low, high in pairwise(edges):
        yield Stretch(slice(begin + low, begin + high), stretch.position[low:high])


class Part(NamedTuple):
    """A part of a reference that repeats.

    Attributes:
        samples: its samples.
        sine: its fundamental, with time from the first finite sample of the part.
    """

    samples: slice
    sine: Sine


def repeating_parts(time: Array, reference: Array, metadata: Mapping[str, Any]) -> tuple[Part, ...]:
    """Return the parts of a reference that repeat with one frequency and one level, in the order of time.

    The search starts from the frequency of the experiment's reference if it is known and fits, otherwise from the first dip of
    the normalised difference function, of the whole reference or of one of its parts.

    Args:
        time: times, shape (n,) [s], increasing.
        reference: reference, shape (n,), NaN where missing.
        metadata: metadata of the recording.

    Returns:
        The parts; none if the reference does not repeat.

    Source: A. de Cheveigné and H. Kawahara, "YIN, a fundamental frequency estimator for speech and music", J. Acoust. Soc. Am.
    111 (2002), for the difference function; IEEE Std 1057 for the fit.
    """
    known = np.flatnonzero(np.isfinite(reference))
    times, values = time[known], reference[known]
    if len(times) < 4 * MIN_CYCLES or np.ptp(values) <= 1e-9 * np.abs(values).max():
        return ()
    step = float(np.median(np.diff(times)))
    even = np.interp(times[0] + np.arange(round(float(times[-1] - times[0]) / step) + 1) * step, times, values)
    everything = (0, len(even))
    as_a_whole = None
    for frequency, whole in _frequencies(even, step, _reference_frequency(metadata)):
        as_a_whole = frequency if whole and as_a_whole is None else as_a_whole
        if spans := _same_level(even, step, frequency):
            break
    else:
        if as_a_whole is None:
            return ()
        frequency, spans = as_a_whole, [everything]
    parts = []
    for begin, end in spans:
        first, last = np.searchsorted(times, times[0] + step * (np.array([begin, end - 1]) + np.array([-0.5, 0.5])))
        if last - first < 4 * MIN_CYCLES:
            continue  # a gap in the recording
        span = slice(0, len(time)) if (begin, end) == everything else slice(int(known[first]), int(known[last - 1]) + 1)
        parts.append(Part(span, fit_sine(times[first:last], values[first:last], frequency)))
    return tuple(parts)


def _frequencies(even: Array, step: float, given: float | None) -> Iterator[tuple[float, bool]]:
    """Yield frequencies with which a signal may repeat [Hz], and whether it does so as a whole.

    Args:
        even: samples at even times, shape (n,).
        step: their distance [s].
        given: frequency to try first [Hz].
    """
    if given is not None and MIN_CYCLES / (len(even) * step) <= given <= 0.25 / step:
        yield given, _repeats(even, round(1.0 / (given * step)))
    for halvings in range(HALVINGS):
        length = len(even) >> halvings
        if length < 4 * MIN_CYCLES:
            return
        for begin in range(0, len(even) - length + 1, max(1, length // 2)):
            part = even[begin : begin + length]
            middle = max(0, (length - MAX_SEARCHED) // 2)
            stride = -(-length // MAX_SEARCHED)
            found = _first_dip(part[middle : middle + MAX_SEARCHED], step)
            if found is None and stride > 1:
                found = _first_dip(part[::stride], step * stride)
            if found is not None:
                yield found, halvings == 0


def _same_level(even: Array, step: float, frequency: float) -> list[tuple[int, int]]:
    """Return the spans in which a signal repeats with one frequency and one level: first sample, and the one after the last.

    Mean, rms and fundamental are compared over one cycle at a time.

    Args:
        even: samples at even times, shape (n,).
        step: their distance [s].
        frequency: the frequency [Hz].

    Returns:
        The spans; none if the signal repeats in too small a part of the time in which it moves.
    """
    period = 1.0 / (frequency * step)
    count = len(even) - period
    if count < (MIN_CYCLES - 1) * period:
        return []
    places = np.linspace(0.0, count, min(MAX_STEPS, 1 + int(np.ceil(count * STEPS_PER_CYCLE / period))))
    middle = float(np.median(even))
    edges, turns = np.arange(len(even) + 1), np.exp(-2j * np.pi / period * (np.arange(len(even)) + 0.5))

    def over_cycle(values: Array) -> Array:
        total = np.concatenate([[0.0], np.cumsum(values)])
        mean: Array = (np.interp(places + period, edges, total) - np.interp(places, edges, total)) / period
        return mean

    mean = over_cycle(even - middle)
    rms = np.sqrt(np.maximum(over_cycle((even - middle) ** 2) - mean**2, 0.0))
    fundamental = 2.0 * np.hypot(over_cycle((even - middle) * turns.real), over_cycle((even - middle) * turns.imag))
    levels = np.column_stack([mean, rms, fundamental])
    moving = rms > MOVING * rms.max()

    def at_level(level: Array) -> NDArray[np.bool_]:
        tolerance = (SAME_LEVEL + (np.pi / period) ** 2) * np.sqrt(2.0) * level[1]
        same: NDArray[np.bool_] = moving & np.all(np.abs(levels - level) <= tolerance, axis=1)
        return same

    tried = levels[np.flatnonzero(moving)[:: max(1, int(moving.sum()) // 64)]]
    same = max((at_level(level) for level in tried), key=np.sum)
    same = at_level(np.median(levels[same], axis=0))
    if same.sum() < MIN_PART * moving.sum():
        return []
    # Few other cycles within a part are left out one by one, as those with another reference.
    on = np.flatnonzero(same)
    whole = same[on[0] : on[-1] + 1].mean() >= 1.0 - MAX_OTHER
    runs = [on] if whole else np.split(on, np.flatnonzero(np.diff(on) > 1) + 1)
    spans = [(round(places[run[0]]), min(len(even), round(places[run[-1]] + period))) for run in runs]
    lag = round(period)
    return [
        (begin, end) for begin, end in spans if end - begin >= round(MIN_CYCLES * period) - 1 and _repeats(even[begin:end], lag)
    ]


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
