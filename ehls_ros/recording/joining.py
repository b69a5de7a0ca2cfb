"""Resampling of the tables of one recording, each with a rate and time stamps, to one clock.

A faster signal is interpolated linearly and averaged over each period of that clock, centred so that it keeps its phase. A
slower one is interpolated by a cubic spline, which adds no content; its rate and noise are kept for later judgement. A held
command is averaged over the following period, in which it acts.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.diagnosis import rules
from ehls_ros.errors import BadInput
from ehls_ros.recording.time_axis import GAP
from ehls_ros.samples import inliers, noise_between_moves
from ehls_ros.trajectory import Own, Preparation, Trajectory

Signal = NDArray[np.float64]

MIN_PERIOD = 4e-4
"""Shortest period of an automatically chosen clock [s]: faster tables are averaged."""

SAME_RATE = 0.02
"""Relative difference of periods up to which a table counts as neither faster nor slower than the clock."""

MIN_COMMON = 0.5
"""Minimum fraction of the shortest table that all tables must have in common."""

MIN_SAMPLES = 4
"""Minimum number of samples for interpolation."""

HELD = ("valve_command_m",)
"""Signals that hold their value until the next sample."""


class _Clock(NamedTuple):
    time: Signal
    period: float


def join(tables: Mapping[str, Trajectory], base: str, where: str) -> Trajectory:
    """Bring the tables of one recording to one clock.

    Args:
        tables: tables by file name, each with times on a common axis.
        base: the table whose clock is used; empty: the fastest one up to 2.5 kHz.
        where: the recording, for errors.

    Returns:
        One trajectory over the time that all tables have in common.

    Raises:
        BadInput: a table is too short, two have the same signal, or they do not overlap.
    """
    for name, table in tables.items():
        if len(table) < MIN_SAMPLES:
            raise BadInput(f"it has {len(table)} samples", f"{where}, {name}", f"at least {MIN_SAMPLES}")
    periods = {name: float(np.median(np.diff(table.time_s))) for name, table in tables.items()}
    chosen = base or _base(periods)
    begin, end = _common(tables, where)
    whole = tables[chosen].time_s
    clock = _Clock(whole[(whole >= begin) & (whole <= end)], periods[chosen])
    signals, interpolated = dict[str, Signal](), dict[str, Own]()
    remarks = [f"{len(tables)} tables are joined at the times of {chosen} ({1.0 / clock.period:.4g} Hz)"]
    for name, table in tables.items():
        remarks += table.preparation.remarks
        ratio = periods[name] / clock.period
        for signal, values in table.signals.items():
            if signal in signals:
                raise BadInput(f"{signal} is in {name} and in another table", where, "one table for it (table: in the map)")
            if values.ndim != 1:
                raise BadInput(f"{signal} of the friction elements is in {name}", where, "them in a recording of one table")
            if name == chosen:
                signals[signal] = values[(whole >= begin) & (whole <= end)]
            else:
                signals[signal] = _at(clock, table.time_s, values, periods[name], ratio, signal in HELD)
            if ratio > 1.0 + SAME_RATE:
                interpolated[signal] = Own(periods[name], noise_between_moves(values[np.isfinite(values)]))
        if name != chosen:
            remarks.append(f"{', '.join(table.signals)}: {_resampling(ratio, periods[name])}")
    return Trajectory(clock.time, signals, preparation=Preparation(tuple(remarks), interpolated))


def _base(periods: Mapping[str, float]) -> str:
    slow_enough = {name: period for name, period in periods.items() if period >= MIN_PERIOD}
    # The first of equally fast ones, in the order given.
    return min(slow_enough, key=slow_enough.__getitem__) if slow_enough else max(periods, key=periods.__getitem__)


def _common(tables: Mapping[str, Trajectory], where: str) -> tuple[float, float]:
    spans = {name: (float(table.time_s[0]), float(table.time_s[-1])) for name, table in tables.items()}
    begin, end = max(b for b, _ in spans.values()), min(e for _, e in spans.values())
    if end - begin < MIN_COMMON * min(e - b for b, e in spans.values()):
        shown = ", ".join(f"{name} {b:.6g} to {e:.6g} s" for name, (b, e) in spans.items())
        expected = (
            "tables of the same time; in the map, 'tables: {file: {name: ..., offset: ...}}' shifts a file's clock, in s, and"
            " 'time_s: {rate: ...}', in Hz, replaces the times of a file whose columns have different ones"
        )
        raise BadInput(f"the tables hardly overlap ({shown})", where, expected)
    return begin, end


def _resampling(ratio: float, period: float) -> str:
    rate = f"{1.0 / period:.4g} Hz"
    if ratio > 1.0 + SAME_RATE:
        return f"interpolated from {rate} by a cubic spline"
    return f"averaged from {rate}" if ratio < 1.0 - SAME_RATE else f"shifted from other times, {rate}"


def _at(clock: _Clock, time: Signal, values: Signal, period: float, ratio: float, held: bool) -> Signal:
    """Return a signal at the times of a clock, NaN where unknown."""
    # A spline or an average would spread an outlier over its neighbours.
    right = np.isfinite(values) if held or len(values) < 2 * MIN_SAMPLES else inliers(values)
    t, known = time[right], values[right]
    if len(t) < MIN_SAMPLES:
        return np.full(len(clock.time), np.nan)
    faster = ratio < 1.0 - SAME_RATE
    if held:
        out = (
            held_mean(t, known, clock.time, clock.period)
            if faster
            else known[_latest(t, clock.time + rules.COMMAND_LATENESS * clock.period)]
        )
    elif faster:
        out = centred_mean(t, known, clock.time, clock.period)
    else:
        out = scipy.interpolate.CubicSpline(t, known)(clock.time)
    after = np.clip(np.searchsorted(t, clock.time), 1, len(t) - 1)
    # Across a gap the signal is unknown. To averages over a period of the clock, gaps up to that period do not matter.
    longest = max(GAP * period, clock.period) if faster else GAP * period
    unknown = (t[after] - t[after - 1] > longest) & (t[after] != clock.time) & (t[after - 1] != clock.time)
    outside = (clock.time < t[0]) | (clock.time > t[-1])
    return np.where((unknown & ~np.bool_(held)) | outside, np.nan, out)


def _latest(time: Signal, at: Signal) -> NDArray[np.intp]:
    return np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)


def centred_mean(time: Signal, values: Signal, at: Signal, width: float) -> Signal:
    """Return the mean of a linearly interpolated signal over an interval centred on each time.

    Args:
        time: sample times, increasing, shape (m,) [s].
        values: samples, shape (m,).
        at: requested times, shape (n,) [s].
        width: averaging interval [s].
    """
    begin, end = np.clip(at - 0.5 * width, time[0], time[-1]), np.clip(at + 0.5 * width, time[0], time[-1])
    areas = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])

    def integral(to: Signal) -> Signal:
        piece = np.clip(np.searchsorted(time, to, side="right") - 1, 0, len(time) - 2)
        since, slope = to - time[piece], np.diff(values)[piece] / np.diff(time)[piece]
        out: Signal = areas[piece] + since * (values[piece] + 0.5 * slope * since)
        return out

    mean: Signal = (integral(end) - integral(begin)) / np.maximum(end - begin, 1e-300)
    return mean


def held_mean(time: Signal, values: Signal, at: Signal, width: float) -> Signal:
    """Return the mean of a held signal over an interval from each time on; arguments as of :func:`centred_mean`."""
    areas = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time))])

    def integral(to: Signal) -> Signal:
        piece = _latest(time, to)
        out: Signal = areas[piece] + (to - time[piece]) * values[piece]
        return out

    mean: Signal = (integral(at + width) - integral(at)) / width
    return mean
