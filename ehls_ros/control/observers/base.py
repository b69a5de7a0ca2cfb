"""What a friction observer's file provides.

``Parameters``, a named tuple that declares its parameters; ``state(model, friction)``, an :class:`ObserverState` before the
first cycle; and ``updater(model)``, which builds the compiled ``update(velocity, period, friction, p, state)`` for a friction
model. ``update`` takes one more measured velocity [m/s] and leaves the estimate in ``state.estimate``: force of the elements
together, viscous force [N], then the force of each element [N], then for each 1 where it slips and 0 where it sticks. A
velocity that is not finite leaves no trace: the last one is held (:func:`held`).

An observer that serves one friction model only names it in ``FRICTION_MODEL``.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.friction.base import FrictionModel
from ehls_ros.physics.integration import WORK_ROWS

ELEMENTS = 2
"""Where an estimate's element forces start."""


class ObserverState(NamedTuple):
    """Everything an observer keeps.

    Attributes:
        forces: forces of the elements [N].
        mode: their modes, as in :mod:`ehls_ros.physics.friction.base`.
        last: last velocity [m/s], and 1 once there was one.
        work: scratch of the integrator.
        estimate: the result, shape (2 + 2 elements,).
    """

    forces: Array
    mode: Array
    last: Array
    work: Array
    estimate: Array


class FrictionObserver(Protocol):
    """The attributes of one observer's file; ``FRICTION_MODEL`` may be absent."""

    Parameters: Any

    def state(self, model: FrictionModel, friction: Any) -> ObserverState:
        """Return the state before the first cycle, for a friction model and its parameters."""

    def updater(self, model: FrictionModel) -> Callable[..., None]:
        """Return the compiled update for a friction model."""


def empty_state(elements: int) -> ObserverState:
    """Return a state at rest for a number of elements."""
    return ObserverState(
        np.zeros(elements), np.zeros(elements), np.zeros(2), np.empty((WORK_ROWS, elements)), np.zeros(2 + 2 * elements)
    )


@kernel
def held(velocity: float, state: ObserverState) -> float:
    """Return a measured velocity, or the last good one where it is not finite [m/s], and remember it."""
    if not math.isfinite(velocity):
        velocity = state.last[0]
    state.last[0], state.last[1] = velocity, 1.0
    return velocity
