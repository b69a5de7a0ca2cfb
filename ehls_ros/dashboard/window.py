"""Signals of the page: minimum and maximum of each in every short interval of the last seconds, and peaks of load cycles."""

import math
import threading
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

INTERVAL = 0.02
"""Length of an interval [s]: 20 cycles at 1 kHz; a plot 300 pixels wide resolves no more of ten seconds."""

INTERVALS = 3100
"""Number of intervals kept: 62 s; the page shows up to the last 60 s."""

OPEN = 6
"""Number of newest intervals held back: topics are read one after another, so some may still add samples."""

PROGRAMME_CYCLES = 8192
"""Control cycles whose position in the programme is kept until their snapshot arrives; a programme is published 200 ahead."""


class WindowPart(NamedTuple):
    """Some intervals of the window.

    Attributes:
        first: number of the first interval.
        following: number to pass to the next call.
        era: changes when the graph's time restarts.
        low: minima, shape (intervals, signals); NaN without samples.
        high: maxima, likewise.
    """

    first: int
    following: int
    era: int
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class Window:
    """A ring of intervals, filled by one thread and read by any."""

    def __init__(self, signals: Sequence[str]) -> None:
        """Start empty.

        Args:
            signals: names, in the order of the columns.
        """
        self.signals = tuple(signals)
        self._column = {name: i for i, name in enumerate(self.signals)}
        self._lock = threading.Lock()
        self._low = np.full((INTERVALS, len(self.signals)), np.nan)
        self._high = np.full((INTERVALS, len(self.signals)), np.nan)
        self._newest = -1
        self._era = 0

    def add(self, time: NDArray[np.float64], values: Mapping[str, NDArray[np.float64]]) -> None:
        """Add samples of some signals.

        Args:
            time: the graph's time [s], not decreasing, shape (n,).
            values: signals by name, each of shape (n,); unknown names are ignored.
        """
        known = [name for name in values if name in self._column]
        if not time.size or not known:
            return
        interval = np.floor(time / INTERVAL).astype(np.int64)
        starts = np.flatnonzero(np.diff(interval, prepend=interval[0] - 1))
        samples = np.column_stack([values[name] for name in known])
        columns = np.array([self._column[name] for name in known])
        numbers = interval[starts]
        low, high = np.fmin.reduceat(samples, starts), np.fmax.reduceat(samples, starts)
        with self._lock:
            self._make_room(int(numbers[-1]))
            kept = numbers > self._newest - INTERVALS
            place = np.ix_(numbers[kept] % INTERVALS, columns)
            self._low[place] = np.fmin(self._low[place], low[kept])
            self._high[place] = np.fmax(self._high[place], high[kept])

    def restart(self) -> None:
        """Clear the window after a restart of the graph's time."""
        with self._lock:
            self._low[:] = self._high[:] = np.nan
            self._newest = -1
            self._era += 1

    def part(self, following: int, era: int) -> WindowPart:
        """Return the intervals completed since the last call; all of them if a new era has begun.

        Args:
            following: of the last part; 0 at first.
            era: of the last part; -1 at first.
        """
        with self._lock:
            end = max(0, self._newest + 1 - OPEN)
            first = max(0 if era != self._era else following, end - INTERVALS + OPEN)
            rows = np.arange(first, end) % INTERVALS
            return WindowPart(first, max(first, end), self._era, self._low[rows], self._high[rows])

    def _make_room(self, newest: int) -> None:
        if newest <= self._newest:
            return
        first = max(self._newest + 1, newest + 1 - INTERVALS)
        rows = np.arange(first, newest + 1) % INTERVALS
        self._low[rows] = self._high[rows] = np.nan
        self._newest = newest


class Peaks:
    """Peak and valley of the last completed load cycle; NaN without a programme."""

    def __init__(self) -> None:
        """Start without a programme."""
        self._cycle = np.full(PROGRAMME_CYCLES, -1, dtype=np.int64)
        self._load_cycle = np.zeros(PROGRAMME_CYCLES, dtype=np.int64)
        self._open: int | None = None
        self._high, self._low = -math.inf, math.inf
        self._peak = self._valley = math.nan

    def note(self, cycle: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> None:
        """Store the position in the programme at some control cycles.

        Args:
            cycle: their numbers, shape (n,).
            columns: fields of ``programme_point`` by name, shape (n,) each.
        """
        within = ~np.isnan(columns["phase"])
        self._cycle[cycle % PROGRAMME_CYCLES] = np.where(within, cycle, -1)
        self._load_cycle[cycle % PROGRAMME_CYCLES] = columns["load_cycles"].astype(np.int64)

    def of(self, cycle: NDArray[np.int64], force: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return peak and valley of the last completed load cycle at consecutive control cycles [N].

        Args:
            cycle: their numbers, shape (n,).
            force: measured force, shape (n,) [N].
        """
        peaks, valleys = np.empty(len(cycle)), np.empty(len(cycle))
        known = self._cycle[cycle % PROGRAMME_CYCLES] == cycle
        for i, (place, inside) in enumerate(
            zip(self._load_cycle[cycle % PROGRAMME_CYCLES].tolist(), known.tolist(), strict=True)
        ):
            if inside:
                self._add(place, float(force[i]))
            peaks[i], valleys[i] = self._peak, self._valley
        return peaks, valleys

    def _add(self, load_cycle: int, force: float) -> None:
        if load_cycle != self._open:
            if self._open is not None and self._high >= self._low:
                self._peak, self._valley = self._high, self._low
            self._open, self._high, self._low = load_cycle, -math.inf, math.inf
        self._high, self._low = max(self._high, force), min(self._low, force)
