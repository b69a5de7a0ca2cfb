"""Peak and valley of each load cycle, as the dashboard plots them."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

KEPT = 8192
"""Control cycles whose position in the programme is kept until their snapshot arrives; a programme is published 200 ahead."""


class Peaks:
    """Peak and valley of the last completed load cycle; NaN without a programme."""

    def __init__(self) -> None:
        """Start without a programme."""
        self._cycle = np.full(KEPT, -1, dtype=np.int64)
        self._load_cycle = np.zeros(KEPT, dtype=np.int64)
        self._open: int | None = None
        self._high, self._low = -math.inf, math.inf
        self._peak = self._valley = math.nan

    def note(self, cycle: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> None:
        """Store the position in the programme at some control cycles.

        Args:
            cycle: their numbers, shape (n,).
            columns: fields of ``programme_point`` by name, shape (n,) each.
        """
        within = ~np.isnan(columns["phase"])
        self._cycle[cycle % KEPT] = np.where(within, cycle, -1)
        self._load_cycle[cycle % KEPT] = columns["load_cycles"].astype(np.int64)

    def of(self, cycle: NDArray[np.int64], force: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return peak and valley of the last completed load cycle at consecutive control cycles [N].

        Args:
            cycle: their numbers, shape (n,).
            force: measured force, shape (n,) [N].
        """
        peaks, valleys = np.empty(len(cycle)), np.empty(len(cycle))
        known = self._cycle[cycle % KEPT] == cycle
        for i, (place, inside) in enumerate(zip(self._load_cycle[cycle % KEPT].tolist(), known.tolist(), strict=True)):
            if inside:
                self._add(place, float(force[i]))
            peaks[i], valleys[i] = self._peak, self._valley
        return peaks, valleys

    def _add(self, load_cycle: int, force: float) -> None:
        if load_cycle != self._open:
            if self._open is not None and self._high >= self._low:
                self._peak, self._valley = self._high, self._low
            self._open, self._high, self._low = load_cycle, -math.inf, math.inf
        self._high, self._low = max(self._high, force), min(self._low, force)
