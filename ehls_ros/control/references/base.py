"""Interface of the file of a reference.

A file has ``Parameters``, a named tuple declaring its parameters, and ``sample(t, p)``. The latter returns the value and its
first two time derivatives, all analytic, shape (n, 3). The times ``t`` [s] have the shape (n,). For a controller that follows a
force, the value is a force [N]. For one that follows a position, and for the position servo, it is a position [m].

A file with a repeating signal may offer ``place(t, p)``, shape (n, :data:`ehls_ros.control.companions.base.PLACE`). It returns
the block, 0 except in a test programme, and the load cycles completed with their fraction. Both are NaN if nothing repeats. A
test programme can run these cycles if the file also declares the phase of its ``VALLEY`` in a cycle. This requires the
parameters ``amplitude`` and ``frequency``.
"""

from typing import Any, Protocol

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companions.base import PLACE


class ReferenceSignal(Protocol):
    """The attributes of a reference's file."""

    Parameters: Any

    def sample(self, t: Array, p: Any) -> Array:
        """Return value, first and second derivative, shape (n, 3)."""


def place_of(t: Array, frequency: float) -> Array:
    """Return block 0 and the load cycles completed with their fraction, shape (n, 2); NaN if nothing repeats.

    Args:
        t: times, shape (n,) [s].
        frequency: frequency of the load cycles [Hz].
    """
    cycles = t * frequency if frequency > 0.0 else np.full(t.shape, np.nan)
    return np.column_stack([np.zeros(t.shape), cycles])


class SampledReference:
    """A reference by cycle number, sampled in blocks."""

    BLOCK = 1024

    def __init__(self, signal: ReferenceSignal, parameters: Any, period: float) -> None:
        """Store a signal with its parameters; ``period`` is the control period [s]."""
        self._signal = signal
        self._parameters = parameters
        self._period = period
        self._first = -1
        self._rows = np.empty((0, 3))

    def row(self, cycle: int) -> Array:
        """Return value, first and second derivative at a cycle, shape (3,)."""
        first = cycle - cycle % self.BLOCK
        if first != self._first:
            t = np.arange(first, first + self.BLOCK, dtype=np.float64) * self._period
            self._rows = self._signal.sample(t, self._parameters)
            self._first = first
        row: Array = self._rows[cycle - first]
        return row

    def place(self, first: int, cycles: int) -> Array:
        """Return the reference's place in its programme for consecutive cycles, shape (cycles, PLACE); NaN if none."""
        where = getattr(self._signal, "place", None)
        if where is None:
            return np.full((cycles, PLACE), np.nan)
        place: Array = where(np.arange(first, first + cycles, dtype=np.float64) * self._period, self._parameters)
        return place

    def rows(self, first: int, cycles: int) -> Array:
        """Return the rows of consecutive cycles, shape (cycles, 3), bitwise equal to those of :meth:`row`."""
        out = np.empty((cycles, 3))
        done = 0
        while done < cycles:
            start = (first + done) % self.BLOCK
            self.row(first + done)
            part = self._rows[start : start + cycles - done]
            out[done : done + len(part)] = part
            done += len(part)
        return out
