"""The last seconds of all signals: minimum and maximum of each in every short interval."""

import threading
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

INTERVAL = 0.02
"""Length of an interval [s]: 20 cycles at 1 kHz; a plot 300 pixels wide resolves no more of ten seconds."""

INTERVALS = 3100
"""Number of intervals kept: 62 s; the page shows up to the last 60 s."""

OPEN = 6
"""Number of newest intervals held back: topics are read one after another, so some may still add samples."""


class Part(NamedTuple):
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

    def part(self, following: int, era: int) -> Part:
        """Return the intervals completed since the last call; all of them if a new era has begun.

        Args:
            following: of the last part; 0 at first.
            era: of the last part; -1 at first.
        """
        with self._lock:
            end = max(0, self._newest + 1 - OPEN)
            first = max(0 if era != self._era else following, end - INTERVALS + OPEN)
            rows = np.arange(first, end) % INTERVALS
            return Part(first, max(first, end), self._era, self._low[rows], self._high[rows])

    def _make_room(self, newest: int) -> None:
        if newest <= self._newest:
            return
        first = max(self._newest + 1, newest + 1 - INTERVALS)
        rows = np.arange(first, newest + 1) % INTERVALS
        self._low[rows] = self._high[rows] = np.nan
        self._newest = newest
