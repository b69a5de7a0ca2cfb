"""The rig's own friction model, whichever it is, run along the measured velocity: A^T B of (16)."""

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.observers.base import ELEMENTS, ObserverState, empty_state, held
from ehls_ros.physics.friction.base import FrictionModel, sign
from ehls_ros.physics.integration import integrator
from ehls_ros.schema import quantity

DRIVING = 1e9
"""Force that drives the measured motion [N]: more than any friction holds."""

MOST_STEPS = 1000
"""Most integration steps between two measurements; a velocity that asks for more is no piston's."""


class Parameters(NamedTuple):
    """How finely the model is run."""

    steps: Annotated[
        int, quantity("1", "least number of integration steps between two measurements", minimum=1, maximum=100)
    ] = 4


class Motion(NamedTuple):
    """Velocity between two measurements: a straight line."""

    friction: Any
    velocity: float
    acceleration: float


def state(model: FrictionModel, friction: Any) -> ObserverState:
    """Return the elements at rest."""
    return empty_state(model.states(friction))


def updater(model: FrictionModel) -> Callable[..., None]:
    """Build the update of one friction model."""
    level, rates, force, event, switch = model.level, model.rates, model.force, model.event, model.switch
    relaxation_rate = kernel(model.relaxation_rate)

    @kernel
    def evaluate(t: float, y: Array, mode: Array, c: Motion, rate: Array) -> float:
        v = c.velocity + c.acceleration * t
        s = level(v, c.friction)
        rates(v, s, y, mode, c.friction, rate)
        return event(v, DRIVING * sign(v), s, y, mode, c.friction)

    @kernel
    def change(t: float, y: Array, mode: Array, c: Motion) -> None:
        v = c.velocity + c.acceleration * t
        switch(v, DRIVING * sign(v), level(v, c.friction), y, mode, c.friction)

    advance = integrator(evaluate, change)

    @kernel
    def update(velocity: float, period: float, friction: Any, p: Parameters, state: ObserverState) -> None:
        """Run the elements from the last measurement to this one."""
        last, started = state.last[0], state.last[1] == 1.0
        velocity = held(velocity, state)
        if started:
            # One step for each time constant of the forces, and more where more are asked for.
            needed = period * relaxation_rate(friction, max(abs(last), abs(velocity)))
            steps = max(p.steps, math.ceil(min(needed, MOST_STEPS)))
            motion = Motion(friction, last, (velocity - last) / period)
            advance(0.0, state.forces, state.mode, motion, period / steps, steps, state.work)
        elements = state.forces.size
        most = level(0.0, friction)
        for i in range(elements):
            value = state.forces[i]
            # Only steps too long for an absurd velocity lead beyond.
            if not abs(value) <= most:
                state.forces[i] = math.copysign(most, value if math.isfinite(value) else velocity)
            state.estimate[ELEMENTS + i] = state.forces[i]
            state.estimate[ELEMENTS + elements + i] = abs(state.mode[i])
        # At v = 0 the viscous term is zero, and what is left is the elements' force.
        state.estimate[0] = force(0.0, 0.0, level(velocity, friction), state.forces, state.mode, friction)
        if elements == 1:
            state.estimate[ELEMENTS] = state.estimate[0]
        state.estimate[1] = friction.viscous_coefficient * velocity

    return update
