"""A force on the beam, as in the paper's simulation: fd(t) is the signal itself."""

from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.disturbances.base import FORCE, FORCE_RATE, ROW
from ehls_ros.control.references.base import SampledReference
from ehls_ros.physics.rig import EffectUse, Rig

REACTS = False


class Parameters(NamedTuple):
    """None: the signal says everything."""


def loader_effects(p: Parameters) -> tuple[EffectUse, ...]:
    """Return none: (3) has fd already."""
    return ()


class Force:
    """The signal as rows."""

    def __init__(self, signal: SampledReference) -> None:
        """Take the force signal."""
        self._signal = signal
        self._row = np.zeros(ROW)

    def first(self) -> Array:
        """Return the row of cycle 0."""
        return self._at(0)

    def following(self, cycle: int, position: float, velocity: float) -> Array:
        """Return the row of cycle + 1; the loader's motion makes no difference."""
        return self._at(cycle + 1)

    def rows(self, first: int, cycles: int) -> Array:
        """Return the rows of consecutive cycles, shape (cycles, ROW)."""
        rows = np.zeros((cycles, ROW))
        rows[:, [FORCE, FORCE_RATE]] = self._signal.rows(first, cycles)[:, :2]
        return rows

    def _at(self, cycle: int) -> Array:
        value, rate, _ = self._signal.row(cycle)
        self._row[FORCE], self._row[FORCE_RATE] = value, rate
        return self._row


def build(p: Parameters, signal: SampledReference, rig: Rig, period: float) -> Force:
    """Return the force ready to run."""
    return Force(signal)
