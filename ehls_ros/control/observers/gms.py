"""The identified GMS model run along the measured velocity: A^T B of (16)."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.observers.base import ELEMENTS, ObserverState, empty_state, held
from ehls_ros.physics.friction import gms
from ehls_ros.physics.friction.base import stribeck_level
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.parameters import Friction
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """How finely the model is run."""

    steps: Annotated[int, quantity("1", "integration steps between two measurements", minimum=1, maximum=100)] = 4


class Motion(NamedTuple):
    """Velocity between two measurements: a straight line."""

    friction: Friction
    velocity: float
    acceleration: float


def state(friction: Friction) -> ObserverState:
    """Return the elements at rest."""
    return empty_state(len(friction.element_stiffness))


@kernel
def _evaluate(t: float, y: Array, mode: Array, c: Motion, rate: Array) -> float:
    v = c.velocity + c.acceleration * t
    level = stribeck_level(v, c.friction)
    gms.rates(v, level, y, mode, c.friction, rate)
    return gms.event(v, 0.0, level, y, mode, c.friction)


@kernel
def _switch(t: float, y: Array, mode: Array, c: Motion) -> None:
    v = c.velocity + c.acceleration * t
    gms.switch(v, 0.0, stribeck_level(v, c.friction), y, mode, c.friction)


_advance = integrator(_evaluate, _switch)


@kernel
def update(velocity: float, period: float, friction: Friction, p: Parameters, state: ObserverState) -> None:
    """Run the elements from the last measurement to this one."""
    last, started = state.last[0], state.last[1] == 1.0
    velocity = held(velocity, state)
    if started:
        motion = Motion(friction, last, (velocity - last) / period)
        _advance(0.0, state.forces, state.mode, motion, period / p.steps, p.steps, state.work)
    elements = state.forces.size
    total = 0.0
    for i in range(elements):
        total += state.forces[i]
        state.estimate[ELEMENTS + i] = state.forces[i]
        state.estimate[ELEMENTS + elements + i] = abs(state.mode[i])
    state.estimate[0] = total
    state.estimate[1] = friction.viscous_coefficient * velocity
