"""Friction model of the rig, of any kind, driven by the measured velocity: A^T B of (16)."""

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.observers.base import ELEMENTS, ObserverState, empty_state, held
from ehls_ros.physics.friction.base import FrictionModel, sign
from ehls_ros.physics.integration import integrator
from ehls_ros.schema import quantity

DRIVING = 1e9
"""Force that drives the measured motion [N], above any friction."""

MAX_STEPS = 1000
"""Largest number of integration steps between two measurements; no piston's velocity needs more."""


class Parameters(NamedTuple):
    """Resolution of the model's integration."""

    steps: Annotated[
        int, quantity("1", "least number of integration steps between two measurements", minimum=1, maximum=100)
    ] = 4


class Motion(NamedTuple):
    """Linear velocity between two measurements."""

    friction: Any
    velocity: float
    acceleration: float


def state(model: FrictionModel, friction: Any) -> ObserverState:
    """Return the elements at rest."""
    return empty_state(model.states(friction))


def driven(model: FrictionModel) -> tuple[Callable[..., float], Callable[..., None]]:
    """Build the system of a friction model's forces under a measured motion.

    Returns:
        ``evaluate`` and ``switch`` for :mod:`~ehls_ros.physics.integration`; ``c`` is a :class:`Motion`, with t = 0 at its
        first measurement.
    """
    level, rates, event, switch = model.level, model.rates, model.event, model.switch

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

    return evaluate, change


def around(model: FrictionModel) -> tuple[Callable[..., tuple[Motion, int]], Callable[..., None]]:
    """Build the parts of the update of one friction model before and after the integration of the elements.

    Returns:
        ``before(velocity, period, friction, p, state)``, which returns the :class:`Motion` since the last measurement and the
        number of its integration steps, 0 at the first; and ``after(friction, state)``, which writes the estimate.
    """
    level, force, begin = model.level, model.force, model.begin
    relaxation_rate = kernel(model.relaxation_rate)

    @kernel
    def before(velocity: float, period: float, friction: Any, p: Parameters, state: ObserverState) -> tuple[Motion, int]:
        last, started = state.last[0], state.last[1] == 1.0
        velocity = held(velocity, state)
        # At least one step for each time constant of the forces.
        needed = period * relaxation_rate(friction, max(abs(last), abs(velocity)))
        steps = max(p.steps, math.ceil(min(needed, MAX_STEPS)))
        return Motion(friction, last, (velocity - last) / period), steps if started else 0

    @kernel
    def after(friction: Any, state: ObserverState) -> None:
        velocity = state.last[0]
        elements = state.forces.size
        most, total, lost = level(0.0, friction), 0.0, False
        for i in range(elements):
            total += state.forces[i]
            lost = lost or not abs(state.forces[i]) <= most
        if lost:
            # At an absurd velocity the steps are too long: reset to a force that the contact can hold.
            begin(total if math.isfinite(total) else math.copysign(most, velocity), most, friction, state.forces)
        for i in range(elements):
            state.estimate[ELEMENTS + i] = state.forces[i]
            state.estimate[ELEMENTS + elements + i] = abs(state.mode[i])
        # At v = 0 the viscous term is zero and the force is that of the elements.
        state.estimate[0] = force(0.0, 0.0, level(velocity, friction), state.forces, state.mode, friction)
        if elements == 1:
            state.estimate[ELEMENTS] = state.estimate[0]
        state.estimate[1] = friction.viscous_coefficient * velocity

    return before, after


def updater(model: FrictionModel) -> Callable[..., None]:
    """Build the update of one friction model."""
    before, after = around(model)
    advance = integrator(*driven(model))

    @kernel
    def update(velocity: float, period: float, friction: Any, p: Parameters, state: ObserverState) -> None:
        """Integrate the elements from the last measurement to this one."""
        motion, steps = before(velocity, period, friction, p, state)
        if steps > 0:
            advance(0.0, state.forces, state.mode, motion, period / steps, steps, state.work)
        after(friction, state)

    return update
