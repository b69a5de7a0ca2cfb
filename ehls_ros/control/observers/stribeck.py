"""The Stribeck curve of the measured velocity, smoothed where it jumps: the compensation of FASMC I."""

import math

from ehls_ros.arrays import kernel
from ehls_ros.control.observers.base import ELEMENTS, ObserverState, empty_state
from ehls_ros.physics.friction.base import stribeck_level
from ehls_ros.physics.parameters import Friction

SMOOTHING = 1.0
"""Width of the smoothed sign, in Stribeck velocities: s(v) tanh(v/(width Vs))."""


def state(friction: Friction) -> ObserverState:
    """Return the state of one element, the curve."""
    return empty_state(1)


@kernel
def smoothed_curve(velocity: float, friction: Friction) -> float:
    """Return the smoothed static friction without its viscous part [N]; ``velocity`` in m/s."""
    width = SMOOTHING * friction.stribeck_velocity
    return stribeck_level(velocity, friction) * math.tanh(velocity / width)


@kernel
def update(velocity: float, period: float, friction: Friction, state: ObserverState) -> None:
    """Look the curve up."""
    value = smoothed_curve(velocity, friction)
    state.last[0], state.last[1] = velocity, 1.0
    state.estimate[0] = value
    state.estimate[1] = friction.viscous_coefficient * velocity
    state.estimate[ELEMENTS] = value
    state.estimate[ELEMENTS + 1] = 1.0
