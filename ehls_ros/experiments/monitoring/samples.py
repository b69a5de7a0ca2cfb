"""Buffer of the samples of the last minutes."""

from collections.abc import Mapping

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.record import USED
from ehls_ros.trajectory import Trajectory

CHUNK = 4096
"""Spare length of the buffer [samples], so that its content is rarely moved."""


class Samples:
    """Buffer of the samples of a limited time, oldest first."""

    def __init__(self, seconds: float) -> None:
        """Start empty.

        Args:
            seconds: length of the time kept [s].
        """
        self._seconds = seconds
        self._rows = np.empty((CHUNK, 1 + len(USED)))
        self._used = 0
        self._there: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of samples."""
        return self._used

    @property
    def times(self) -> Array:
        """Times of the samples, shape (n,) [s]."""
        return self._rows[: self._used, 0]

    def add(self, time_s: Array, signals: Mapping[str, Array]) -> None:
        """Append samples.

        Args:
            time_s: increasing times, shape (n,) [s].
            signals: values by the names of the data contract, NaN where missing, shape (n,).
        """
        self._there = tuple(name for name in USED if name in signals)
        self._make_room(len(time_s))
        rows = self._rows[self._used : self._used + len(time_s)]
        rows[:, 0] = time_s
        for column, name in enumerate(USED, start=1):
            rows[:, column] = signals.get(name, np.nan)
        self._used += len(time_s)

    def between(self, begin: float, end: float) -> Trajectory:
        """Return the samples of an interval, as a recording that begins at 0.

        Args:
            begin: first time [s].
            end: time after the last [s].
        """
        first, last = np.searchsorted(self.times, [begin, end])
        rows = self._rows[first:last].copy()
        time = rows[:, 0] - (rows[0, 0] if len(rows) else 0.0)
        return Trajectory(time, {name: rows[:, 1 + USED.index(name)] for name in self._there})

    def _make_room(self, count: int) -> None:
        if self._used + count <= len(self._rows):
            return
        if self._used:
            oldest = int(np.searchsorted(self.times, self.times[-1] - self._seconds))
            self._rows[: self._used - oldest] = self._rows[oldest : self._used].copy()
            self._used -= oldest
        if self._used + count > len(self._rows):
            grown = np.empty((self._used + count + CHUNK, self._rows.shape[1]))
            grown[: self._used] = self._rows[: self._used]
            self._rows = grown
