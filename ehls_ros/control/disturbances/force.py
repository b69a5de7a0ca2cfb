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

    def rows(self, first: int, cycles: int) -> Array:
        """Return the rows of consecutive cycles, shape (cycles, ROW)."""
        rows = np.zeros((cycles, ROW))
        rows[:, [FORCE, FORCE_RATE]] = self._signal.rows(first, cycles)[:, :2]
        return rows


def build(p: Parameters, signal: SampledReference, rig: Rig, period: float) -> Force:
    """Return the force ready to run."""
    return Force(signal)
