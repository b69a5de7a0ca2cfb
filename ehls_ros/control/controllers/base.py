"""What a controller's file provides.

``Parameters``, a named tuple declaring its parameters; ``FOLLOWS``, what the reference it follows is, force or
position; ``FRICTION``, whether it uses the friction estimate; ``NEEDS``, the readings it cannot do without;
``memory(parameters)``, its state before the first cycle; ``FRICTION_MODEL``, where it contains one friction model
and serves no other; and a compiled

``step(m, r, f, p, model, memory, status) -> spool command [m]``

with ``m`` the measurement in the order of :data:`ehls_ros.physics.rig.SENSED`, ``r`` the reference and its first
and second derivative, [N, N/s, N/s^2] for a force and [m, m/s, m/s^2] for a position, ``f`` friction of the
elements and viscous friction [N], ``p`` its parameters, ``model`` the :class:`Model`, ``memory`` updated in
place, and ``status`` filled in place by the indices below. It keeps the command within ``model.spool_limit``
without winding up, and finite whatever the measurement; a measurement that is not finite leaves nothing in
``memory``.

A law that reckons with the commands under way, or adapts to what its own do, adds a compiled

``follow(command, own, memory) -> own``

It is called between two steps while another controller drives, with the command [m] that went to the valve and the one that
the last step returned. It corrects ``memory`` by that, and returns what the step would then have returned.
"""

import math
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig

E3, S, ALPHA, BETA, DELTA, U1, U2, U3, FORCE_ERROR, FORCE_BOUND, SATURATED, STATUS_SIZE = range(12)
"""Where a status holds its quantities; and its size. Pressures and masses are in the paper's units, MPa and t."""

STATUS_TO_SI = np.ones(STATUS_SIZE)
"""SI value of one unit of each quantity, for messages and recordings."""
STATUS_TO_SI[[E3, S]] = 1e6
STATUS_TO_SI[[U1, U2, U3]] = 1e9

ELEMENTS_FORCE, VISCOUS_FORCE = 0, 1
"""Where a friction estimate holds its two forces."""


class Model(NamedTuple):
    """What a controller knows of the rig; ``friction`` are the parameters of its friction model."""

    plant: Plant
    friction: Any
    period: float
    spool_limit: float


class ControllerLaw(Protocol):
    """The attributes of one controller's file; ``FRICTION_MODEL`` and ``follow`` may be absent."""

    Parameters: Any
    FOLLOWS: Literal["force", "position"]
    FRICTION: bool
    NEEDS: tuple[str, ...]

    def memory(self, p: Any) -> Array:
        """Return the state before the first cycle."""

    def step(self, m: Array, r: Array, f: Array, p: Any, model: Model, memory: Array, status: Array) -> float:
        """Return the spool command [m]."""


def model_of(rig: Rig, period: float) -> Model:
    """Return the rig as a controller may know it: its parameters, not its effects."""
    return Model(rig.plant, rig.friction, period, rig.limits.spool)


@kernel
def saturate(value: float, limit: float) -> float:
    """Cut a value to [-limit, limit]; NaN becomes 0."""
    if math.isnan(value):
        return 0.0
    return min(max(value, -limit), limit)
