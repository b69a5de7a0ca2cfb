"""Check and repair of the time axis of a recording, for every reader.

An axis is strictly increasing in the end. Times rounded to few digits are put back on their even grid, and few repeated times
are placed or left out, both with a remark; a stray stamp, a clock that was set back, or a gap that no memory could hold is
refused before anything is allocated.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.columns import TIME

Times = NDArray[np.float64]

RowName = Callable[[int], str]
"""Function that returns the designation of a row in messages, such as ``line 12``."""

MIN_ROWS = 20
"""Number of rows from which a grid is recognised with repeated times."""

MIN_ROWS_INCREASING = 100
"""Number of rows from which a grid is recognised without repeated times."""

EVEN = 0.01
"""Relative difference of time steps up to which an axis is even; as for the diagnosis."""

MISFIT = 1.5
"""Largest distance of a time from its grid, in half widths of its rounding; above 1 for the error of the fitted grid."""

PLAIN_DIGITS = 5
"""Maximum number of digits of a rate or period that is preferred to the fitted one."""

MIN_SPAN = 100.0
"""Minimum length of a grid, in half widths of the rounding, for a rate known to a per cent."""

FEW = 0.01
"""Fraction of rows up to which repeated times are few."""

MIN_ROWS_FEW = 10
"""Number of rows from which a single repeated time is repaired."""

FITS = 0.25
"""Largest distance of a time from an even step, in steps, for a repeated time to be placed."""

GAP = 3.5
"""Step from which an axis has a gap, in usual steps; in joined tables the signal is unknown there."""

FEW_GAPS = 0.05
"""Fraction of steps up to which long ones are gaps; more are an uneven axis."""

JUMP, JUMP_OF_REST = 100.0, 10.0
"""Step from which two rows may be on different clocks: in usual steps, and in lengths of the rest of the recording."""

STRAY = 0.1
"""Fraction of rows up to which those on another clock are stray."""

DAY = 86400.0
"""Jump of the time above which a recording is refused, if it is also a jump by the measures above [s]."""

INCREASING = "a time that increases with every row"


class TimeAxis(NamedTuple):
    """Checked time axis.

    Attributes:
        time: strictly increasing times, shape (n,) [s].
        rows: indices of the rows kept, shape (n,); None for all.
        remarks: repairs and gaps, one sentence each.
        unevenness: largest relative deviation of a step from the usual one, gaps left out.
    """

    time: Times
    rows: NDArray[np.intp] | None
    remarks: tuple[str, ...]
    unevenness: float

    @property
    def rate(self) -> float:
        """Usual rate [Hz]; NaN for a single row."""
        return 1.0 / float(np.median(np.diff(self.time))) if len(self.time) > 1 else float("nan")


def time_axis(time: Times, where: str, row_name: RowName, written: NDArray[np.float64] | None = None) -> TimeAxis:
    """Check a time axis, and repair it where the repair is certain.

    Args:
        time: times as read, shape (n,) [s].
        where: the recording, for errors.
        row_name: returns the designation of a row.
        written: the times as written in the file, whose digits give their rounding, shape (n,); None: as ``time``.

    Returns:
        The axis.

    Raises:
        BadInput: a time is missing or on another clock, many times repeat, time goes back, or a gap is absurdly long.
    """
    if not len(time):
        raise BadInput("there is no sample", where, "at least one sample")
    unknown = np.flatnonzero(~np.isfinite(time))
    if len(unknown):
        raise BadInput(f"{TIME} is {time[unknown[0]]}", f"{where}, {row_name(int(unknown[0]))}", "a finite time")
    usual = check_jumps(time, where, row_name)
    steps = np.diff(time)
    if np.any(steps < 0.0):
        raise _goes_back(time, steps, usual, where, row_name)
    repeated = int(np.count_nonzero(steps == 0.0))
    unevenness = _unevenness(steps, usual)
    grid = _grid(time, time if written is None else written, steps, usual) if repeated or unevenness > EVEN else None
    if grid is not None:
        period = float(np.median(np.diff(grid)))
        remark = f"{TIME} has few digits: the even grid of {1.0 / period:.6g} Hz is used, which explains every time within them"
        if repeated:
            remark += f"; {repeated} rows repeat the time before"
        return TimeAxis(grid, None, (remark, *_gaps(grid, period, row_name)), 0.0)
    rows, remarks = None, list[str]()
    if repeated:
        if len(time) < MIN_ROWS_FEW or repeated > max(1.0, FEW * len(time)):
            raise _repeats(time, steps, where, row_name)
        time, rows, remarks = _repaired(time, steps, usual, row_name)
    kept = rows
    named = row_name if kept is None else (lambda k: row_name(int(kept[k])))
    if repeated:
        unevenness = _unevenness(np.diff(time), usual)
    return TimeAxis(time, rows, (*remarks, *_gaps(time, usual, named)), unevenness)


def copied_rows(time: Times, signals: Mapping[str, NDArray[np.float64]]) -> NDArray[np.bool_] | None:
    """Return the rows that repeat time and signals of the row before, if all rows with a repeated time do and are many.

    Args:
        time: times, shape (n,) [s].
        signals: signals, shape (n,) or (n, elements).
    """
    repeated = np.diff(time) == 0.0
    if np.count_nonzero(repeated) <= max(1.0, FEW * len(time)) or not any(np.ptp(s) > 0.0 for s in signals.values()):
        return None
    places = np.flatnonzero(repeated)
    same = all(np.array_equal(s[places], s[places + 1], equal_nan=True) for s in signals.values())
    return np.concatenate([[False], repeated]) if same else None


def shown(time: float) -> str:
    """Return a time with the digits that a float in Unix seconds resolves."""
    return repr(float(f"{time:.13g}"))


def length(seconds: float) -> str:
    """Return a duration in a readable unit."""
    for unit, size in (("days", DAY), ("h", 3600.0), ("s", 1.0)):
        if abs(seconds) >= 2.0 * size or unit == "s":
            return f"{seconds / size:.6g} {unit}"
    raise AssertionError


def _in_gaps(steps: Times, usual: float) -> NDArray[np.bool_]:
    """Return the steps that are gaps: few long ones, or up to half of them if all others are even, as between blocks."""
    long = steps > GAP * usual
    count = np.count_nonzero(long)
    even = count <= 0.5 * len(steps) and bool(np.all(np.abs(steps[~long] - usual) <= FITS * usual))
    return long if count <= max(1.0, FEW_GAPS * len(steps)) or even else np.zeros(len(steps), dtype=np.bool_)


def _unevenness(steps: Times, usual: float) -> float:
    plain = steps[~_in_gaps(steps, usual)]
    return float(np.max(np.abs(plain - usual))) / usual if len(plain) and usual > 0.0 else 0.0


def check_jumps(time: Times, where: str, row_name: RowName) -> float:
    """Reject rows on different clocks, and a recording that would not fit in memory on an even axis.

    Args:
        time: finite times, shape (n,) [s].
        where: the recording, for errors.
        row_name: returns the designation of a row.

    Returns:
        The usual step [s]; 0 without an increasing one.

    Raises:
        BadInput: a row is on another clock, or a gap is absurdly long.
    """
    steps = np.diff(time)
    positive = steps[steps > 0.0]
    if not len(positive):
        return 0.0
    middle = (len(positive) - 1) // 2
    usual = float(np.partition(positive, middle)[middle])
    sizes = np.abs(steps)
    rest = float(np.sum(sizes[sizes <= JUMP * usual]))
    jumps = np.flatnonzero(sizes > max(JUMP * usual, JUMP_OF_REST * rest))
    if len(jumps):
        begins = np.concatenate([[0], jumps + 1])
        ends = np.concatenate([jumps + 1, [len(time)]])
        most = int(np.argmax(ends - begins))
        usually = float(np.median(time[begins[most] : ends[most]]))
        stray = np.zeros(len(time), dtype=np.bool_)
        for begin, end in zip(begins, ends, strict=True):
            far = abs(float(time[begin]) - usually) > DAY
            stray[begin:end] = end - begin <= max(1.0, STRAY * len(time)) and (far or not np.any(time[begin:end]))
        if np.any(stray) and np.mean(stray) < 0.5:
            first, others = int(np.argmax(stray)), time[~stray]
            count = f", and {np.count_nonzero(stray) - 1} more rows are astray" if np.count_nonzero(stray) > 1 else ""
            what = f"{TIME} is {shown(time[first])}; the others have {shown(others.min())} to {shown(others.max())}{count}"
            remedy = f"one clock for all rows: leave the row out, or {TIME}: {{rate: ...}} in the map, in Hz, if rows are even"
            raise BadInput(what, f"{where}, {row_name(first)}", remedy)
    span = float(np.max(time) - np.min(time))
    worst = int(np.argmax(sizes))
    absurd = len(jumps) > 0 and sizes[worst] > DAY
    if absurd or span > limits.ROWS * usual:
        what = f"{TIME} jumps from {shown(time[worst])} to {shown(time[worst + 1])}, by {length(float(steps[worst]))}"
        if not absurd:
            what += f"; at {1.0 / usual:.4g} Hz its {len(time)} rows extend over {span / usual:.3g}"
        remedy = f"at most {limits.ROWS} rows with those of the gaps, and no gap of days; split the recording at the gap"
        raise BadInput(what, f"{where}, {row_name(worst + 1)}", remedy)
    return usual


def _goes_back(time: Times, steps: Times, usual: float, where: str, row_name: RowName) -> BadInput:
    """Return the error for a time that goes back: a stray stamp, a clock set back by one size, or rows out of order."""
    backwards = np.flatnonzero(steps < 0.0)
    row = int(backwards[0]) + 1
    remedy = "split the file there"
    # A stamp ahead of its time is followed by one that goes back, though that one is right.
    ahead = row > 1 and time[row] > time[row - 2] and time[row - 1] - time[row - 2] > GAP * usual
    row -= int(ahead)
    what = f"{TIME} is {shown(time[row])} after {shown(time[row - 1])}"
    if ahead or (row + 1 < len(time) and time[row + 1] > time[row - 1]):
        what += f" and before {shown(time[row + 1])}"
        remedy = "leave the row out"
    else:
        sizes = usual - steps[backwards]
        if np.any(steps == 0.0) or (len(backwards) > 1 and float(np.ptp(sizes)) > usual):
            what += f"; {np.count_nonzero(steps == 0.0)} rows repeat the time before, {len(backwards)} go back"
        elif len(time) > MIN_ROWS_FEW:
            often = f" in {len(backwards)} rows" if len(backwards) > 1 else ""
            what += f"; the clock is set back by {float(f'{np.median(sizes):.6g}')} s{often}"
    rate = f"{1.0 / usual:.6g}" if usual > 0.0 else "..."
    expected = f"{INCREASING}: {remedy}; or if rows are even, {TIME}: {{rate: {rate}}} in the map, in Hz"
    return BadInput(what, f"{where}, {row_name(row)}", expected)


def _repeats(time: Times, steps: Times, where: str, row_name: RowName) -> BadInput:
    repeated = np.flatnonzero(steps == 0.0)
    row = int(repeated[0]) + 1
    what = f"{TIME} is {shown(time[row])} after {shown(time[row - 1])}"
    if len(repeated) > 1:
        what += f"; {len(repeated)} rows repeat the time before, and no even grid explains them"
    expected = f"{INCREASING}; if rows are even, {TIME}: {{rate: ...}} in the map, in Hz"
    return BadInput(what, f"{where}, {row_name(row)}", expected)


def _roundings(written: Times) -> Iterator[Times]:
    """Yield the half widths of rounding that the digits of numbers permit: decimals, significant digits, binary digits."""
    looked = written[:: max(1, len(written) // 20_000)]
    resolution = np.spacing(np.abs(looked))

    def rounded(unit: NDArray[np.float64] | float) -> bool:
        if np.any(resolution > 0.1 * unit):
            return False
        return bool(np.all(np.abs(looked - np.rint(looked / unit) * unit) <= 1e-6 * unit + 2.0 * resolution))

    decimals = next((d for d in range(-3, 10) if rounded(10.0**-d)), None)
    if decimals is not None:
        yield np.full(len(written), 0.5 * 10.0**-decimals)

    def exponent(values: Times) -> Times:
        out: Times = np.floor(np.log10(np.where(values == 0.0, 1.0, np.abs(values))) + 1e-12)
        return out

    digits = next((s for s in range(2, 10) if rounded(10.0 ** (exponent(looked) - s + 1))), None)
    if digits is not None:
        yield np.asarray(0.5 * 10.0 ** (exponent(written) - digits + 1))
    if np.array_equal(looked, looked.astype(np.float32).astype(np.float64)):
        yield 0.5 * np.spacing(np.abs(written).astype(np.float32)).astype(np.float64)
    yield np.spacing(np.abs(written))


def _grid(time: Times, written: Times, steps: Times, usual: float) -> Times | None:
    """Return the even grid that explains all times within their rounding; None if there is none."""
    if len(time) < (MIN_ROWS_INCREASING if np.all(steps > 0.0) else MIN_ROWS):
        return None
    span = np.ptp(written)
    scale = float(time[-1] - time[0]) / float(written[-1] - written[0]) if span > 0.0 else 0.0
    for half in _roundings(written):
        width = abs(scale) * half
        width = np.maximum(width, 1e-9 * float(np.max(width)))
        if scale == 0.0 or float(time[-1] - time[0]) < MIN_SPAN * float(np.max(width)):
            continue
        number = np.arange(len(time), dtype=np.float64)
        long = steps > GAP * max(usual, 2.0 * float(np.max(width)))
        if np.any(long):
            # A gap is a whole number of periods, by the period of the longest stretch.
            edges = np.concatenate([[0], np.flatnonzero(long) + 1, [len(time)]])
            place = int(np.argmax(np.diff(edges)))
            stretch = slice(int(edges[place]), int(edges[place + 1]))
            period = _line(number[stretch], time[stretch], width[stretch])[1]
            if period <= 0.0:
                continue
            number[1:] += np.cumsum(np.where(long, np.rint(steps / period) - 1.0, 0.0))
        start, period = _line(number, time, width)
        grid = start + period * number
        if period > 0.0 and bool(np.all(np.abs(time - grid) <= MISFIT * width)):
            return _plainest(number, time, width, period, grid)
    return None


def _plainest(number: Times, time: Times, width: Times, period: float, grid: Times) -> Times:
    """Return the grid of the rate or period with the fewest digits that explains all times, otherwise the fitted grid."""
    slack = 1e-6 * float(np.max(width))  # of times half way between two digits
    for digits in range(1, PLAIN_DIGITS + 1):
        for plain in (1.0 / float(f"{1.0 / period:.{digits}g}"), float(f"{period:.{digits}g}")):
            begins = time - plain * number
            low, high = float(np.max(begins - width)), float(np.min(begins + width))
            if low <= high + slack:
                return float(np.clip(grid[0], min(low, high), max(low, high))) + plain * number
    return grid


def _line(number: Times, time: Times, width: Times) -> tuple[float, float]:
    """Return start and period of a line through times, weighted by their rounding."""
    if len(number) < 2:
        return 0.0, 0.0
    weight = 1.0 / np.square(width)
    weight /= np.sum(weight)
    at, mean = float(weight @ number), float(weight @ time)
    off = number - at
    period = float((weight * off) @ (time - mean)) / float(weight @ np.square(off))
    return mean - period * at, period


def _repaired(time: Times, steps: Times, usual: float, row_name: RowName) -> tuple[Times, NDArray[np.intp] | None, list[str]]:
    """Place few repeated times on the even steps around them, or leave their rows out."""
    time, keep = time.copy(), np.ones(len(time), dtype=np.bool_)
    placed, dropped = list[int](), list[int]()
    for first in np.flatnonzero((steps == 0.0) & np.concatenate([[True], steps[:-1] > 0.0])) + 1:
        end = int(first)
        while end < len(time) and time[end] == time[first - 1]:
            end += 1
        count, stamp = end - int(first), float(time[first - 1])
        needed = (count + 1) * usual
        # Of late stamps, the last is right; of a stamp held, the first.
        if end < len(time) and abs(time[end] - stamp - needed) <= FITS * usual:
            time[first:end] = stamp + usual * np.arange(1, count + 1)
            placed.append(int(first))
        elif first > 1 and abs(stamp - time[first - 2] - needed) <= FITS * usual:
            time[first - 1 : end - 1] = time[first - 2] + usual * np.arange(1, count + 1)
            placed.append(int(first) - 1)
        else:
            keep[first:end] = False
            dropped.append(int(first))
    remarks = []
    if placed:
        row = placed[0]
        others = f", and so are {len(placed) - 1} others" if len(placed) > 1 else ""
        remarks.append(
            f"{row_name(row)} has a repeated time: {TIME} {shown(time[row])} is taken from the even steps around it{others}"
        )
    if dropped:
        row = dropped[0]
        others = f", and so are {len(dropped) - 1} others" if len(dropped) > 1 else ""
        remarks.append(f"{row_name(row)} repeats the time before ({shown(time[row])} s) and is left out{others}")
    rows = None if np.all(keep) else np.flatnonzero(keep)
    return time[keep], rows, remarks


def _gaps(time: Times, usual: float, row_name: RowName) -> list[str]:
    """Describe the gaps of an increasing axis; none if its steps are uneven anyway."""
    steps = np.diff(time)
    gaps = np.flatnonzero(_in_gaps(steps, usual))
    if not len(gaps):
        return []
    worst = int(gaps[np.argmax(steps[gaps])])
    count = "a gap" if len(gaps) == 1 else f"{len(gaps)} gaps, the longest"
    span = f"from {shown(time[worst])} to {shown(time[worst + 1])} s ({length(float(steps[worst]))})"
    return [f"{TIME} has {count} before {row_name(worst + 1)}, {span}"]
