"""What a disturbance's file provides.

``Parameters``; ``REACTS``, whether the actuator under test feels the loader; ``loader_effects(p)``, the effects through which
it enters the loader's plant; and ``build(p, signal, rig, period)``, a :class:`Source`. The signal it follows is any reference:
a force [N], or the displacement [m] of an actuator that reacts.

What feels the loader is part of the plant, and is integrated with it. So a file with ``REACTS`` also has ``servo(p, rig,
start)``, the :class:`~ehls_ros.physics.servo.Servo` that starts at a position [m]; its rows are the motion that the servo is to
follow.
"""

from typing import Any, Protocol

from ehls_ros.arrays import Array
from ehls_ros.control.references.base import SampledReference
from ehls_ros.physics.rig import EffectUse, Rig

FORCE, FORCE_RATE, DISPLACEMENT, VELOCITY, ROW = range(5)
"""Where a row holds force [N], its rate [N/s], displacement [m] and velocity [m/s]; and its length."""


class Source(Protocol):
    """A disturbance by cycle."""

    def rows(self, first: int, cycles: int) -> Array:
        """Return the rows of consecutive cycles, shape (cycles, ROW)."""


class DisturbanceKind(Protocol):
    """The attributes of one disturbance's file."""

    Parameters: Any
    REACTS: bool

    def loader_effects(self, p: Any) -> tuple[EffectUse, ...]:
        """Return the effects to switch on in the loader's plant."""

    def build(self, p: Any, signal: SampledReference, rig: Rig, period: float) -> Source:
        """Return the disturbance ready to run."""
