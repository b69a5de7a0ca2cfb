"""Withdrawal of a correction that makes the force error larger than it is without.

The error of load cycles without correction is the measure. A load cycle with correction whose squared error runs ahead of that
measure is left at once, and one that ends with a larger error is not followed by another. A correction that has been withdrawn
stays away for a number of load cycles that doubles each time, and halves again as corrections prove good.
"""

import numpy as np

from ehls_ros.arrays import Array

MARGIN = 0.5
"""Squared error by which a load cycle may run ahead of those without correction, over the sum of theirs."""

WORSE = 1.05
"""Rms error of a load cycle, over that without correction, above which the correction did harm."""

TRANSIENT = 0.5
"""Squared error of a load cycle, over that of the one before, below which the one before held a transient."""

WAIT, LONGEST_WAIT = 4, 64
"""Load cycles for which a correction that did harm stays away, the first time and at most."""


class Withdrawal:
    """The error without correction, and how often a correction has exceeded it.

    Attributes:
        bare: sum of the squared error without correction up to each sample of the load cycle, shape (size,) [N^2]; infinite as
            long as it is not known.
        repeats: whether two load cycles in succession have shown an error of that size.
        waiting: load cycles for which the correction still stays away.
    """

    def __init__(self, size: int) -> None:
        """Know nothing of a load cycle of ``size`` samples."""
        self.bare = np.full(size, np.inf)
        self.repeats = False
        self.waiting = 0
        self._count = self._good = 0

    def observe(self, error: Array) -> None:
        """Take in the error [N] of a load cycle without any correction, shape (size,)."""
        squares, before = np.cumsum(error**2), float(self.bare[-1])
        lasts = bool(squares[-1] >= TRANSIENT * before)
        self.repeats = self.repeats or lasts
        self.bare = 0.5 * (self.bare + squares) if lasts else squares
        self.waiting = max(self.waiting - 1, 0)

    def exceeds(self, squares: float, samples: int) -> bool:
        """Return whether the squared error of a load cycle with correction runs ahead of that without.

        Args:
            squares: its sum so far [N^2].
            samples: samples so far.
        """
        return squares > float(self.bare[min(samples, len(self.bare)) - 1] + MARGIN * self.bare[-1])

    def did_harm(self, error: Array) -> bool:
        """Return whether a load cycle with correction has a larger error than those without; note if it has a smaller one.

        Args:
            error: shape (size,) [N].
        """
        if float(error @ error) > WORSE**2 * float(self.bare[-1]):
            return True
        self._good += 1
        if self._good >= 2**self._count:
            self._count, self._good = max(self._count - 1, 0), 0
        return False

    def withdraw(self) -> None:
        """Keep the correction away for a while."""
        self._count, self._good = self._count + 1, 0
        self.waiting = min(WAIT * 2 ** (self._count - 1), LONGEST_WAIT)
