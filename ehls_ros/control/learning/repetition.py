"""Where a control cycle stands in its load cycle, and what was recorded of a load cycle once it is complete.

The load cycle follows from the number of the control cycle where its period is given, and from the place in the programme
otherwise. Neither counts what was answered, so that missed cycles do not shift the phase.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import BLOCK, REPETITIONS

LONGEST = 200_000
"""Samples of the longest load cycle that is learnt."""

ROUNDING = 1e-6
"""Part of a load cycle by which a place may be off."""

PHASE, WANTED, ERROR, EXTERNAL, FORESEEN, PREVIEWED, SMOOTHED, COLUMNS = range(8)
"""Columns of a record: phase [load cycles], reference [N], force error [N], external force as it seemed at once [N], foreseen
external force, that part of it which others foresaw, both NaN where nothing is foreseen [N], and external force as it seems
later, NaN where that is not known yet [N]; and their number."""


SEAM = 32
"""Samples from which the difference between two load cycles is led over at the end of a load cycle's known part."""


class Turn(NamedTuple):
    """One load cycle of a programme.

    Attributes:
        block: number of the block.
        number: of the load cycle.
    """

    block: int
    number: int


class Places:
    """Tells load cycles and phases."""

    def __init__(self, cycles: int) -> None:
        """Take the control cycles of a load cycle; 0: the programme's place says where it is."""
        self._cycles = cycles

    def turn(self, cycle: int, place: Array) -> Turn | None:
        """Return the load cycle of a control cycle; None where nothing repeats.

        Args:
            cycle: its number.
            place: place in the programme, shape (PLACE,).
        """
        block, repetitions = float(place[BLOCK]), float(place[REPETITIONS])
        if self._cycles:
            return Turn(0 if math.isnan(block) else int(block), cycle // self._cycles)
        if math.isnan(repetitions):
            return None
        return Turn(0 if math.isnan(block) else int(block), math.floor(repetitions + ROUNDING))

    def phases(self, cycle: int, place: Array, turn: Turn) -> Array:
        """Return the phases of control cycles on end in one load cycle, shape (n,), 0 to 1.

        Args:
            cycle: number of the first.
            place: places in the programme, shape (n, PLACE).
            turn: that load cycle.
        """
        if len(place) == 1:
            at = cycle % self._cycles / self._cycles if self._cycles else max(float(place[0, REPETITIONS]) - turn.number, 0.0)
            return np.array([at])
        if self._cycles:
            return (cycle % self._cycles + np.arange(len(place))) / self._cycles
        phases: Array = np.maximum(place[:, REPETITIONS] - turn.number, 0.0)
        return phases

    def together(self, cycle: int, place: Array) -> int:
        """Return how many of some control cycles on end, one at least, are of the same load cycle as the first.

        Args:
            cycle: number of the first.
            place: places in the programme, shape (n, PLACE).
        """
        blocks = place[:, BLOCK]
        same = (blocks == blocks[0]) | (np.isnan(blocks) & np.isnan(blocks[0]))
        if self._cycles:
            here = cycle % self._cycles + np.arange(len(place)) < self._cycles
        else:
            numbers = np.floor(place[:, REPETITIONS] + ROUNDING)
            here = (numbers == numbers[0]) | (np.isnan(numbers) & np.isnan(numbers[0]))
        differs = np.flatnonzero(~(same & here))
        return int(differs[0]) if differs.size else len(place)


class LoadCycle(NamedTuple):
    """A complete load cycle, resampled evenly from phase 0 on.

    Attributes:
        period: control cycles it took, not always a whole number.
        columns: shape (samples, COLUMNS).
    """

    period: float
    columns: Array


class Recorder:
    """Records load cycles."""

    def __init__(self) -> None:
        """Start empty."""
        self._rows = np.empty((1024, COLUMNS))
        self._count = 0
        self._next = -1
        self._before, self._before_next = np.empty((0, COLUMNS)), -1
        self.whole = False

    def begin(self, *, follows: bool = False) -> None:
        """Forget what there is: a load cycle begins, which may follow the one recorded, of the same block."""
        keep = follows and self.whole
        self._before, self._before_next = self._rows[: self._count if keep else 0].copy(), self._next
        self._count, self.whole = 0, True

    def spoil(self) -> None:
        """Let this load cycle not count."""
        self.whole = False

    def add(self, cycle: int, count: int) -> Array:
        """Return the rows for control cycles on end, to be filled; cycles missed before them spoil the load cycle.

        Args:
            cycle: number of the first.
            count: how many.

        Returns:
            Shape (count, COLUMNS), a view.
        """
        if self._count > 0 and cycle != self._next:
            self.spoil()
        self._next = cycle + count
        if not self.whole or self._count + count > LONGEST:
            self.spoil()
            self._count = 0
        end = self._count + count
        if end > len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty((max(end, len(self._rows)), COLUMNS))])
        rows = self._rows[self._count : end]
        self._count = end
        return rows

    def smoothed(self, first: int, forces: Array) -> None:
        """Write external forces that have become known, of control cycles from ``first`` on, shape (n,) [N]."""
        for rows, end in ((self._before, self._before_next), (self._rows[: self._count], self._next)):
            begin = end - len(rows)
            low, high = max(first, begin), min(first + len(forces), end)
            if low < high:
                rows[low - begin : high - begin, SMOOTHED] = forces[low - first : high - first]

    def latest(self, count: int) -> Array | None:
        """Return the last rows on end, shape (count, COLUMNS); None if fewer are there."""
        if not self.whole or self._count < count:
            return None
        return self._rows[self._count - count : self._count]

    def full(self) -> bool:
        """Tell whether the next control cycle would be of the next load cycle."""
        count = self._count
        if not self.whole or count < 8:
            return False
        first, last = self._rows[0, PHASE], self._rows[count - 1, PHASE]
        step = (last - first) / (count - 1)
        return bool(last + step > 1.0 - ROUNDING)

    def complete(self) -> LoadCycle | None:
        """Return the load cycle if nothing of it is missing."""
        count, rows = self._count, self._rows
        phase = rows[:count, PHASE]
        if not self.full() or not np.all(np.isfinite(rows[:count, :FORESEEN])):
            return None
        period = (count - 1) / float(phase[-1] - phase[0])
        if phase[0] * period > 1.0 - ROUNDING * period or abs(period - count) > 1.0:
            return None
        size = round(period)
        if abs(period - size) < 1e-3 and size == count and phase[0] * period < 1e-3:
            period, columns = float(size), rows[:count].copy()
            at = phase
        else:
            at = np.arange(size) / size
            columns = np.column_stack([np.interp(at, phase, rows[:count, column], period=1.0) for column in range(COLUMNS)])
            columns[:, PHASE] = at
        before = self._before[np.isfinite(self._before[:, SMOOTHED])]
        late = np.isnan(columns[:, SMOOTHED])
        if late.any() and len(before) > 1:
            # What is not known yet of this load cycle is that of the one before.
            late &= (at >= before[0, PHASE]) & (at <= before[-1, PHASE])
            earlier = np.interp(at, before[:, PHASE], before[:, SMOOTHED])
            columns[late, SMOOTHED] = earlier[late] + _led_over(columns[:, SMOOTHED] - earlier, late)
        return LoadCycle(period, columns)


def _led_over(difference: Array, late: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Array:
    """Return what leads from the end of a load cycle's known part over to the load cycle before it.

    A force that differs between both would have a step there, which a law that foresees it follows. The load cycle before ends
    where this one began, so that nothing is added at the end.

    Args:
        difference: force of this load cycle less that of the one before, shape (size,) [N]; unknown where ``late``.
        late: samples at the end that are not known, shape (size,).
    """
    count = int(np.sum(late))
    known = np.flatnonzero(~late)[-SEAM:]
    if not late[-1] or len(known) < SEAM or known[-1] != len(late) - count - 1:
        return np.zeros(count)
    at = np.arange(SEAM) - (SEAM - 1.0)
    _, slope, value = np.polyfit(at, difference[known], 2)
    share = np.arange(1, count + 1) / (count + 1)
    # Hermite's cubic with the value and slope of the known part, and neither at the end.
    led: Array = (1.0 - share) ** 2 * (value * (1.0 + 2.0 * share) + slope * (count + 1) * share)
    return led
