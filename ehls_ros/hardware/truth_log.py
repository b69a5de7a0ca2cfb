"""The true signals of the emulated rig, cycle by cycle, kept in memory until the end of the run."""

from pathlib import Path

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.trajectory import MEASURED

COLUMNS = (
    "time_s",
    *MEASURED,
    "disturbance_displacement_m",
    "disturbance_velocity_m_s",
    "output_raw",
    "output_status",
    "output_sequence",
    "output_answered",
    "monotonic_s",
)
"""Names of the data contract; raw output, its status (:class:`ehls_ros.hardware.packet.Status`), number of the last command and
of the measurement it answers, and this computer's clock."""

BLOCK = 4096
"""Rows allocated at a time, few enough not to delay a cycle."""


class TruthLog:
    """Rows of :data:`COLUMNS`."""

    def __init__(self) -> None:
        """Allocate the first block."""
        self._blocks: list[Array] = []
        self._next = BLOCK
        self._grow()

    def add(self, row: tuple[float, ...]) -> None:
        """Append a row."""
        if self._next == BLOCK:
            self._grow()
        self._blocks[-1][self._next] = row
        self._next += 1

    def rows(self) -> Array:
        """Return all rows, shape (cycles, columns)."""
        return np.concatenate([*self._blocks[:-1], self._blocks[-1][: self._next]])

    def write(self, path: Path) -> None:
        """Write the rows as CSV.

        Raises:
            OSError: the file cannot be written.
        """
        with path.open("w", encoding="utf-8") as stream:
            stream.write(",".join(COLUMNS) + "\n")
            stream.writelines(",".join(map(repr, row)) + "\n" for row in self.rows().tolist())

    def _grow(self) -> None:
        # Written at once, so that adding a row causes no page fault.
        block = np.empty((BLOCK, len(COLUMNS)))
        block.fill(0.0)
        self._blocks.append(block)
        self._next = 0
