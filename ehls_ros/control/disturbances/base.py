"""Interface of the file of a disturbance.

A file has ``Parameters``; ``REACTS``, whether the loader acts back on the actuator under test; ``loader_effects(p)``, the
effects through which it enters the loader's plant; and ``build(p, signal, rig, period)``, which returns a :class:`Source`. The
signal it follows is any reference: a force [N], or the displacement [m] of an actuator that reacts.

An actuator that reacts is part of the plant, and is integrated with it. Therefore a file with ``REACTS`` also has
``servo(p, rig, start)``, the :class:`~ehls_ros.physics.servo.Servo` that starts at a position [m]; its rows are the motion
setpoint of the servo.
"""

from typing import Any, Protocol

from ehls_ros.arrays import Array
from ehls_ros.control.references.base import SampledReference
from ehls_ros.physics.rig import EffectUse, Rig

FORCE, FORCE_RATE, DISPLACEMENT, VELOCITY, ROW = range(5)
"""Indices of a row: force [N], force rate [N/s], displacement [m] and velocity [m/s]; and its length."""


class Source(Protocol):
    """Source of a disturbance's rows by cycle."""

    def rows(self, first: int, cycles: int) -> Array:
        """Return the rows of consecutive cycles, shape (cycles, ROW)."""


class DisturbanceKind(Protocol):
    """The attributes of a disturbance's file."""

    Parameters: Any
    REACTS: bool

    def loader_effects(self, p: Any) -> tuple[EffectUse, ...]:
        """Return the effects to enable in the loader's plant."""

    def build(self, p: Any, signal: SampledReference, rig: Rig, period: float) -> Source:
        """Return the source of the disturbance."""
