"""Withdraw a correction that makes the force error larger than without it.

The error of load cycles without correction is the reference. If the cumulative squared error of a load cycle with correction
exceeds it by a margin, the correction is withdrawn at once; if the load cycle ends with a larger error, it is withdrawn for the
next one. The waiting time of a withdrawn correction, in load cycles, doubles each time, and halves again as corrections prove
good.
"""

import numpy as np

from ehls_ros.arrays import Array

MARGIN = 0.5
"""Margin of a load cycle's squared error over that without correction, as a fraction of the latter's sum."""

WORSE = 1.05
"""Ratio of a load cycle's rms error to that without correction above which the correction is withdrawn."""

TRANSIENT = 0.5
"""Ratio of a load cycle's squared error to that of the previous one below which the previous one contained a transient."""

WAIT, MAX_WAIT = 4, 64
"""Load cycles for which a harmful correction is withdrawn, the first time and at most."""


class Withdrawal:
    """Error without correction, and the history of corrections that exceeded it.

    Attributes:
        bare: cumulative squared error without correction up to each sample of the load cycle, shape (size,) [N^2]; infinite
            while unknown.
        repeats: whether two successive load cycles have shown an error of that size.
        waiting: load cycles for which the correction remains withdrawn.
    """

    def __init__(self, size: int) -> None:
        """Start without observations, for a load cycle of ``size`` samples."""
        self.bare = np.full(size, np.inf)
        self.repeats = False
        self.waiting = 0
        self._count = self._good = 0

    def observe(self, error: Array) -> None:
        """Process the error [N] of a load cycle without any correction, shape (size,)."""
        squares, before = np.cumsum(error**2), float(self.bare[-1])
        lasts = bool(squares[-1] >= TRANSIENT * before)
        self.repeats = self.repeats or lasts
        self.bare = 0.5 * (self.bare + squares) if lasts else squares
        self.waiting = max(self.waiting - 1, 0)

    def exceeds(self, squares: float, samples: int) -> bool:
        """Return whether the cumulative squared error of a load cycle with correction exceeds the margin.

        Args:
            squares: cumulative squared error so far [N^2].
            samples: samples so far.
        """
        return squares > float(self.bare[min(samples, len(self.bare)) - 1] + MARGIN * self.bare[-1])

    def is_worse(self, error: Array) -> bool:
        """Return whether a load cycle with correction has a larger error than those without; count a smaller one as good.

        Args:
            error: error [N], shape (size,).
        """
        if float(error @ error) > WORSE**2 * float(self.bare[-1]):
            return True
        self._good += 1
        if self._good >= 2**self._count:
            self._count, self._good = max(self._count - 1, 0), 0
        return False

    def withdraw(self) -> None:
        """Withdraw the correction for a number of load cycles."""
        self._count, self._good = self._count + 1, 0
        self.waiting = min(WAIT * 2 ** (self._count - 1), MAX_WAIT)
