"""Bumpless changes of a reference correction, without jumps of it or of its rate."""

from collections.abc import Hashable

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references._signals import quintic


class Bumpless:
    """Smooth transition from one correction to the next.

    When the source of the correction changes, the old one is continued along a straight line and faded into the new one.
    """

    def __init__(self, period: float) -> None:
        """Start without correction; ``period`` is the control period [s]."""
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Reset to no correction."""
        self._source: Hashable = None
        self._cycle, self._value, self._rate = -1, 0.0, 0.0
        self._began, self._length, self._usual = 0, 0, 0
        self._apart, self._speed = 0.0, 0.0

    def smooth(self, first: int, rows: Array, bare: Array, source: Hashable, length: int) -> None:
        """Smooth the correction in some rows, as a continuation of that in previous rows.

        Args:
            first: number of their first control cycle.
            rows: reference with its two derivatives, shape (n, 3 or more); changed in place.
            bare: the reference without correction, shape (n, 3).
            source: origin of the correction; rows without correction have the source None.
            length: control cycles of a transition; a change to another source takes the longer of both.
        """
        if source is None and self._source is None and first - self._began >= self._length:
            return
        for i, (row, plain) in enumerate(zip(rows, bare, strict=True)):
            cycle, added = first + i, row[:3] - plain
            here = source if np.any(added) else None
            if here != self._source:
                passed = (cycle - self._cycle) * self._period
                self._apart = self._value + self._rate * passed - added[0]
                self._speed = self._rate - added[1]
                self._source, self._began = here, cycle
                self._length, self._usual = max(self._usual, length), length
            if cycle - self._began < self._length:
                added += self._rest(cycle - self._began)
                row[:3] = plain + added
            self._cycle, self._value, self._rate = cycle, float(added[0]), float(added[1])

    def _rest(self, cycles: int) -> Array:
        """Return the remainder of the old correction to add to the new one, with its two derivatives, shape (3,)."""
        since = cycles * self._period
        fade, rate, bend = (float(part[0]) for part in quintic(np.array([since]), self._length * self._period))
        apart = self._apart + self._speed * since
        return np.array(
            [(1.0 - fade) * apart, (1.0 - fade) * self._speed - rate * apart, -2.0 * rate * self._speed - bend * apart]
        )
