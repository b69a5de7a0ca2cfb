"""Friction compensation of FASMC I: steady sliding friction at the measured velocity, smoothed about zero velocity."""

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from ehls_ros.arrays import kernel
from ehls_ros.control.observers.base import ELEMENTS, ObserverState, empty_state, held
from ehls_ros.physics.friction.base import FrictionModel
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Smoothing of the curve: s(v) tanh(v/smoothing)."""

    smoothing: Annotated[
        float, quantity("m/s", "velocity over which the curve changes sides", minimum=1e-6, maximum=10.0, scale="speed")
    ] = 0.2


def state(model: FrictionModel, friction: Any) -> ObserverState:
    """Return the state of one element, the curve."""
    return empty_state(1)


def updater(model: FrictionModel) -> Callable[..., None]:
    """Build the update with the curve of one friction model."""
    level = model.level

    @kernel
    def update(velocity: float, period: float, friction: Any, p: Parameters, state: ObserverState) -> None:
        """Evaluate the curve."""
        velocity = held(velocity, state)
        value = level(velocity, friction) * math.tanh(velocity / p.smoothing)
        state.estimate[0] = value
        state.estimate[1] = friction.viscous_coefficient * velocity
        state.estimate[ELEMENTS] = value
        state.estimate[ELEMENTS + 1] = 1.0

    return update
