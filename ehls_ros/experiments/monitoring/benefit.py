"""Benefit of informing a controller of a change: the force error before and after."""

import math

import numpy as np

from ehls_ros.arrays import Array


class Benefit:
    """Comparison of the force error over equal times before and after a controller is informed.

    Attributes:
        informed: whether the controller has been informed.
    """

    def __init__(self, cycles: int) -> None:
        """Start the measurement.

        Args:
            cycles: number of control cycles before and after.
        """
        self._cycles = cycles
        self._squares = [0.0, 0.0]
        self._largest = [0.0, 0.0]
        self._counts = [0, 0]
        self._left = 0
        self.informed = False

    @property
    def ready(self) -> bool:
        """Whether enough cycles have been measured to inform the controller."""
        return not self.informed and self._counts[0] >= self._cycles

    @property
    def complete(self) -> bool:
        """Whether enough cycles have been measured after informing the controller."""
        return self._counts[1] >= self._cycles

    def add(self, errors: Array) -> None:
        """Add the force errors of some cycles, NaN where missing, shape (n,) [N]."""
        errors = errors[np.isfinite(errors)]
        if self._left > 0:
            skipped = min(self._left, len(errors))
            self._left, errors = self._left - skipped, errors[skipped:]
        part = int(self.informed)
        if not len(errors) or self._counts[part] >= self._cycles:
            return
        self._counts[part] += len(errors)
        self._squares[part] += float(errors @ errors)
        self._largest[part] = max(self._largest[part], float(np.max(np.abs(errors))))

    def inform(self, settling: int) -> None:
        """Register that the controller is informed.

        Args:
            settling: number of following cycles that are not counted.
        """
        self.informed, self._left = True, settling

    def sentence(self) -> str:
        """Describe the benefit."""
        before, after = (math.sqrt(s / max(n, 1)) for s, n in zip(self._squares, self._counts, strict=True))
        largest = " to ".join(f"{value:.3g}" for value in self._largest)
        return (
            f"force error before and after the controller was informed: {before:.3g} to {after:.3g} N rms, {largest} N at most"
        )
