"""Signals over a load cycle: moving averages, and tables of learnt signals with their derivatives."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ehls_ros.control.learning.robustness import Spectrum


def mean_around(values: NDArray[Any], reach: int) -> NDArray[Any]:
    """Return the mean of each value and ``reach`` values on either side, with periodic continuation at the ends."""
    reach = min(reach, (len(values) - 1) // 2)
    if reach == 0:
        return values
    padded = np.concatenate([values[-reach:], values, values[:reach]])
    total = np.concatenate([[0.0], np.cumsum(padded)])
    width = 2 * reach + 1
    mean: NDArray[Any] = (total[width:] - total[:-width]) / width
    return mean if np.iscomplexobj(mean) else np.maximum(mean, 0.0)


class PeriodicSignal:
    """Learnt signal over a load cycle.

    Attributes:
        size: samples of the load cycle.
        cycles: number of load cycles used.
        table: the signal and its two derivatives at the samples, the first again at the end, shape (size + 1, 3).
    """

    STORED: ClassVar[tuple[str, ...]]
    """Attributes to keep for the next run; a leading underscore is not part of the stored name."""

    def __init__(self, size: int, period: float) -> None:
        """Start with a zero signal.

        Args:
            size: samples of the load cycle.
            period: length of the load cycle [s].
        """
        self.size, self.cycles = size, 0
        self.table = np.zeros((size + 1, 3))
        self._derivative = 2j * math.pi / period * np.arange(size // 2 + 1)
        # The highest harmonic of an even number of samples has no phase, and so no derivative.
        self._derivative[-1] *= size % 2

    def _tabulate(self, spectrum: Spectrum) -> None:
        """Fill the table from the signal's ``rfft``."""
        for column in range(3):
            self.table[:-1, column] = np.fft.irfft(self._derivative**column * spectrum, self.size)
        self.table[-1] = self.table[0]

    def stored(self) -> dict[str, NDArray[Any]]:
        """Return the learnt arrays, by name."""
        return {"cycles": np.array(self.cycles), **{name.strip("_"): getattr(self, name) for name in self.STORED}}

    def restore(self, stored: Mapping[str, NDArray[Any]]) -> bool:
        """Restore arrays returned by :meth:`stored`; return whether they fit."""
        values = {name: stored.get(name.strip("_")) for name in self.STORED}
        if any(value is None or value.shape != getattr(self, name).shape for name, value in values.items()):
            return False
        for name, value in values.items():
            setattr(self, name, value)
        self.cycles = int(stored["cycles"])
        return True
