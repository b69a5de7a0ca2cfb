"""A force on the beam, as in the paper's simulation: fd(t) is the signal."""

from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.disturbances.base import FORCE, FORCE_RATE, ROW
from ehls_ros.control.references.base import SampledReference
from ehls_ros.physics.rig import EffectUse, Rig

REACTS = False


class Parameters(NamedTuple):
    """No parameters: the signal defines the disturbance."""


def loader_effects(p: Parameters) -> tuple[EffectUse, ...]:
    """Return no effects, as (3) already contains fd."""
    return ()


class Force:
    """Force signal as rows."""

    def __init__(self, signal: SampledReference) -> None:
        """Store the force signal."""
        self._signal = signal

    def rows(self, first: int, cycles: int) -> Array:
        """Return the rows of consecutive cycles, shape (cycles, ROW)."""
        rows = np.zeros((cycles, ROW))
        rows[:, [FORCE, FORCE_RATE]] = self._signal.rows(first, cycles)[:, :2]
        return rows


def build(p: Parameters, signal: SampledReference, rig: Rig, period: float) -> Force:
    """Return the source of the force."""
    return Force(signal)
