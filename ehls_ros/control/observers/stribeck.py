"""The Stribeck curve of the measured velocity, smoothed where it jumps: the compensation of FASMC I."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import kernel
from ehls_ros.control.observers.base import ELEMENTS, ObserverState, empty_state, held
from ehls_ros.physics.friction.base import stribeck_level
from ehls_ros.physics.parameters import Friction
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """How the curve is smoothed: s(v) tanh(v/smoothing)."""

    smoothing: Annotated[float, quantity("m/s", "velocity over which the curve changes sides", minimum=1e-6, maximum=10.0)] = (
        0.2
    )


def state(friction: Friction) -> ObserverState:
    """Return the state of one element, the curve."""
    return empty_state(1)


@kernel
def smoothed_curve(velocity: float, friction: Friction, p: Parameters) -> float:
    """Return the smoothed static friction without its viscous part [N]; ``velocity`` in m/s."""
    return stribeck_level(velocity, friction) * math.tanh(velocity / p.smoothing)


@kernel
def update(velocity: float, period: float, friction: Friction, p: Parameters, state: ObserverState) -> None:
    """Look the curve up."""
    velocity = held(velocity, state)
    value = smoothed_curve(velocity, friction, p)
    state.estimate[0] = value
    state.estimate[1] = friction.viscous_coefficient * velocity
    state.estimate[ELEMENTS] = value
    state.estimate[ELEMENTS + 1] = 1.0
