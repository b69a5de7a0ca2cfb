"""What really happened on the emulated rig, cycle by cycle, kept in memory until it is over."""

from pathlib import Path

import numpy as np

from ehls_ros.arrays import Array

COLUMNS = (
    "time_s",
    "valve_command_m",
    "spool_m",
    "load_pressure_pa",
    "supply_pressure_pa",
    "position_m",
    "velocity_m_s",
    "force_n",
    "disturbance_force_n",
    "oil_temperature_k",
    "disturbance_displacement_m",
    "disturbance_velocity_m_s",
    "output_raw",
    "output_status",
    "monotonic_s",
)
"""Names of the data contract; raw output, its status (:class:`ehls_ros.hardware.packet.Status`), and the computer's clock."""

BLOCK = 4096
"""Rows that memory is taken for at a time, few enough that it takes no noticeable time."""


class TruthLog:
    """Rows of :data:`COLUMNS`."""

    def __init__(self) -> None:
        """Take the first block of memory."""
        self._blocks: list[Array] = []
        self._next = BLOCK
        self._grow()

    def add(self, row: tuple[float, ...]) -> None:
        """Keep a row."""
        if self._next == BLOCK:
            self._grow()
        self._blocks[-1][self._next] = row
        self._next += 1

    def rows(self) -> Array:
        """Return all rows, shape (cycles, columns)."""
        return np.concatenate([*self._blocks[:-1], self._blocks[-1][: self._next]])

    def write(self, path: Path) -> None:
        """Write them as CSV.

        Raises:
            OSError: the file cannot be written.
        """
        with path.open("w", encoding="utf-8") as stream:
            stream.write(",".join(COLUMNS) + "\n")
            stream.writelines(",".join(map(repr, row)) + "\n" for row in self.rows().tolist())

    def _grow(self) -> None:
        # Zeros written, so that no page is missing when a row comes.
        block = np.empty((BLOCK, len(COLUMNS)))
        block.fill(0.0)
        self._blocks.append(block)
        self._next = 0
