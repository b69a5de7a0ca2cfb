"""What a disturbance's file provides.

``Parameters``; ``REACTS``, whether it feels the loader; ``loader_effects(p)``, the effects through which it
enters the loader's plant; and ``build(p, signal, rig, period)``, a :class:`Source`, a
:class:`Planned` one where it does not react. The signal it follows is
any reference: a force [N] or a displacement [m].
"""

from typing import Any, Protocol

from ehls_ros.arrays import Array
from ehls_ros.control.references.base import SampledReference
from ehls_ros.physics.rig import EffectUse, Rig

FORCE, FORCE_RATE, DISPLACEMENT, VELOCITY, ROW = range(5)
"""Where a row holds force [N], its rate [N/s], displacement [m] and velocity [m/s]; and its length."""


class Source(Protocol):
    """A running disturbance, evaluated once a cycle, one cycle ahead."""

    def first(self) -> Array:
        """Return the row of cycle 0."""

    def following(self, cycle: int, position: float, velocity: float) -> Array:
        """Return the row of cycle + 1, given the loader's position [m] and velocity [m/s] at a cycle."""


class Planned(Source, Protocol):
    """A disturbance that does not react: any number of cycles can be computed at once."""

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
