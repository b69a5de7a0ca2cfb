"""Phase of a control cycle in its load cycle, and the record of a complete load cycle.

The load cycle follows from the number of the control cycle if its period is given, otherwise from the place in the programme.
Neither depends on the number of answered cycles, so that missed cycles do not shift the phase.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import BLOCK, REPETITIONS

MAX_SAMPLES = 200_000
"""Samples of the longest load cycle that is learnt."""

ROUNDING = 1e-6
"""Tolerance of a place for rounding, as a fraction of a load cycle."""

PHASE, WANTED, ERROR, EXTERNAL, FORESEEN, PREVIEWED, SMOOTHED, COLUMNS = range(8)
"""Columns of a record, and their number: phase [load cycles], reference [N], force error [N], immediate estimate of the
external force [N], foreseen external force and its part foreseen by others, both NaN if nothing is foreseen [N], and smoothed
external force, NaN where not yet known [N]."""


SEAM = 32
"""Samples at the end of a load cycle's known part from which the difference between two load cycles is extrapolated."""


class Turn(NamedTuple):
    """One load cycle of a programme.

    Attributes:
        block: number of the block.
        number: number of the load cycle.
    """

    block: int
    number: int


class Places:
    """Map control cycles to load cycles and phases."""

    def __init__(self, cycles: int) -> None:
        """Set the control cycles of a load cycle; 0 to follow the place in the programme."""
        self._cycles = cycles

    def turn(self, cycle: int, place: Array) -> Turn | None:
        """Return the load cycle of a control cycle; None if nothing repeats.

        Args:
            cycle: number of the control cycle.
            place: place in the programme, shape (PLACE,).
        """
        block, repetitions = float(place[BLOCK]), float(place[REPETITIONS])
        if self._cycles:
            return Turn(0 if math.isnan(block) else int(block), cycle // self._cycles)
        if math.isnan(repetitions):
            return None
        return Turn(0 if math.isnan(block) else int(block), math.floor(repetitions + ROUNDING))

    def phases(self, cycle: int, place: Array, turn: Turn) -> Array:
        """Return the phases of contiguous control cycles in one load cycle, shape (n,), 0 to 1.

        Args:
            cycle: number of the first cycle.
            place: places in the programme, shape (n, PLACE).
            turn: the load cycle.
        """
        if len(place) == 1:
            at = cycle % self._cycles / self._cycles if self._cycles else max(float(place[0, REPETITIONS]) - turn.number, 0.0)
            return np.array([at])
        if self._cycles:
            return (cycle % self._cycles + np.arange(len(place))) / self._cycles
        phases: Array = np.maximum(place[:, REPETITIONS] - turn.number, 0.0)
        return phases

    def together(self, cycle: int, place: Array) -> int:
        """Return the number of contiguous control cycles, at least one, in the same load cycle as the first.

        Args:
            cycle: number of the first cycle.
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
        period: length in control cycles, not necessarily a whole number.
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
        """Start a load cycle, keeping the recorded one if the new one may follow it in the same block."""
        keep = follows and self.whole
        self._before, self._before_next = self._rows[: self._count if keep else 0].copy(), self._next
        self._count, self.whole = 0, True

    def invalidate(self) -> None:
        """Mark this load cycle as incomplete."""
        self.whole = False

    def add(self, cycle: int, count: int) -> Array:
        """Return the rows for contiguous control cycles, to be filled; missed cycles before them spoil the load cycle.

        Args:
            cycle: number of the first cycle.
            count: number of cycles.

        Returns:
            Shape (count, COLUMNS), a view.
        """
        if self._count > 0 and cycle != self._next:
            self.invalidate()
        self._next = cycle + count
        if not self.whole or self._count + count > MAX_SAMPLES:
            self.invalidate()
            self._count = 0
        end = self._count + count
        if end > len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty((max(end, len(self._rows)), COLUMNS))])
        rows = self._rows[self._count : end]
        self._count = end
        return rows

    def smoothed(self, first: int, forces: Array) -> None:
        """Write smoothed external forces, now known for control cycles from ``first`` on, shape (n,) [N]."""
        for rows, end in ((self._before, self._before_next), (self._rows[: self._count], self._next)):
            begin = end - len(rows)
            low, high = max(first, begin), min(first + len(forces), end)
            if low < high:
                rows[low - begin : high - begin, SMOOTHED] = forces[low - first : high - first]

    def latest(self, count: int) -> Array | None:
        """Return the last contiguous rows, shape (count, COLUMNS); None if there are fewer."""
        if not self.whole or self._count < count:
            return None
        return self._rows[self._count - count : self._count]

    def full(self) -> bool:
        """Return whether the next control cycle belongs to the next load cycle."""
        count = self._count
        if not self.whole or count < 8:
            return False
        first, last = self._rows[0, PHASE], self._rows[count - 1, PHASE]
        step = (last - first) / (count - 1)
        return bool(last + step > 1.0 - ROUNDING)

    def complete(self) -> LoadCycle | None:
        """Return the load cycle if it is complete, otherwise None."""
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
            # Samples not yet known are taken from the previous load cycle.
            late &= (at >= before[0, PHASE]) & (at <= before[-1, PHASE])
            earlier = np.interp(at, before[:, PHASE], before[:, SMOOTHED])
            columns[late, SMOOTHED] = earlier[late] + _extrapolated(columns[:, SMOOTHED] - earlier, late)
        return LoadCycle(period, columns)


def _extrapolated(difference: Array, late: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Array:
    """Return the transition from the end of a load cycle's known part to the load cycle before it.

    If the force differs between both, there would be a step, which a law with preview would follow. The previous load cycle
    ends where this one began, so the transition decays to zero.

    Args:
        difference: force of this load cycle minus that of the previous one, shape (size,) [N]; unknown where ``late``.
        late: mask of the unknown samples at the end, shape (size,).
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
