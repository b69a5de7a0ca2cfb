"""A friction model run along a recorded motion."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.duals import dual_array, value_of
from ehls_ros.physics.imposed_motion.base import (
    Body,
    Imposed,
    ModelRun,
    Scratch,
    coefficients,
    effect_integrator,
    set_sample,
    write_slopes,
)
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.plant import FRICTION, Chains, V, balance_with, break_away_with, relations

STEEP, FINE = 0.1, 6
"""Change of velocity within a sample, relative to speed plus Stribeck velocity, above which the Stribeck level is nonlinear;
and the least number of steps in such a sample."""

TINY = 1e-300
"""Speed that triggers a reversal and is otherwise negligible [m/s]."""


class FrictionInputs(NamedTuple):
    """Inputs of the part besides the recording.

    Attributes:
        extra: force of the effects beyond (3), shape (n,) [N].
        balance: friction that balances the other forces at the start of each stretch, shape (stretches,) [N].
        velocity_scale: velocity over which the Stribeck level changes; infinite if it is constant [m/s].
    """

    extra: Array
    balance: Array
    velocity_scale: float

    @property
    def varied(self) -> tuple[Any, ...]:
        """Arrays that may be duals."""
        return self.extra, self.balance

    @property
    def values_alone(self) -> "FrictionInputs":
        """The inputs without derivatives."""
        return self._replace(extra=value_of(self.extra), balance=value_of(self.balance))


def of_duals(width: int) -> Callable[..., FrictionInputs]:
    """Build the function that returns the inputs as duals, from the rows of :attr:`FrictionInputs.varied`."""

    @kernel
    def inputs_of(inputs: FrictionInputs, rows: tuple[Array, Array]) -> FrictionInputs:
        return FrictionInputs(dual_array(rows[0], width), dual_array(rows[1], width), inputs.velocity_scale)

    return inputs_of


class Interval(NamedTuple):
    """Inputs of a friction model during one step, all linear in the time since its start.

    Attributes:
        friction: parameters of the model.
        velocity: velocity at the start [m/s].
        acceleration: rate of ``velocity`` [m/s^2].
        level: Stribeck level at the start [N].
        level_rate: rate of ``level`` [N/s].
        applied: sum of all other forces on the mass at the start [N].
        applied_rate: rate of ``applied`` [N/s].
    """

    friction: Any
    velocity: float
    acceleration: float
    level: float
    level_rate: float
    applied: float
    applied_rate: float


def friction_integrator(friction: Any, elements: int) -> Callable[..., int]:
    """Build the integrator of a friction model's forces.

    Args:
        friction: module of the friction model.
        elements: number of the model's forces.

    Returns:
        ``advance`` of :func:`~ehls_ros.physics.integration.integrator`, with the forces as state and an :class:`Interval` as
        ``c``.
    """
    rates, event, change = friction.rates, friction.event, friction.switch

    @kernel_no_refcount
    def evaluate(t: float, y: Array, mode: Array, c: Interval, rate: Array) -> float:
        v, level = c.velocity + c.acceleration * t, c.level + c.level_rate * t
        rates(v, level, y, mode, c.friction, rate)  # (6), (8)
        return event(v, c.applied + c.applied_rate * t, level, y, mode, c.friction)

    @kernel_no_refcount
    def switch(t: float, y: Array, mode: Array, c: Interval) -> None:
        v, level = c.velocity + c.acceleration * t, c.level + c.level_rate * t
        change(v, c.applied + c.applied_rate * t, level, y, mode, c.friction)

    return integrator(evaluate, switch, size=elements, order=2)


def build(friction: Any, elements: int, states: int, chains: Chains) -> Body:
    """Build the part, which writes the friction force [N]; its inputs are :class:`FrictionInputs`.

    Args:
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the effects.
    """
    balance, advance_effects = balance_with(friction, chains), effect_integrator(relations(chains), states)
    advance, force, change, begin = friction_integrator(friction, elements), friction.force, friction.switch, friction.begin
    break_away = break_away_with(friction)

    @kernel_no_refcount
    def start(v: float, applied: float, level: float, balance: float, p: Any, forces: Array, mode: Array) -> None:
        # Friction may still be falling from the break-away force.
        begin(balance, break_away(level, v, p), p, forces)
        if v != 0.0:
            # An infinite applied force releases a static model.
            change(v, math.copysign(math.inf, v), level, forces, mode, p)
        else:
            change(v, applied, level, forces, mode, p)

    @kernel_no_refcount
    def run_samples(a: ModelRun, inputs: FrictionInputs, measured: Scratch, own: Scratch, out: Array) -> None:
        y, w, slope, forces, mode = measured.y, measured.w, measured.slope, own.y, own.mode
        last = a.motion.time.size - 1
        level, applied, stretch = 0.0, 0.0, 0
        set_sample(0, a, y, w)
        for k in range(last + 1):
            t, z = a.motion.time[k], y[FRICTION:]
            if a.fresh[k]:
                z[:] = 0.0
                mode[:] = 0.0
                level, applied = balance(inputs.extra[k], t, y, z, coefficients(a, w))
                start(y[V], applied, level, inputs.balance[stretch], a.friction, forces, mode)
                stretch += 1
            write_slopes(k, a, slope)
            if y[V] == 0.0 and slope[V] == 0.0:
                # At rest: a tiny reversed velocity makes the slipping elements stick.
                for i in range(elements):
                    if mode[i] != 0.0:
                        change(-mode[i] * TINY, applied, level, forces, mode, a.friction)
            out[k, 0] = force(y[V], applied, level, forces, mode, a.friction)
            if k == last:
                break
            steep = abs(slope[V]) * a.period > STEEP * (abs(y[V]) + inputs.velocity_scale)
            steps = max(a.steps, FINE) if steep else a.steps
            step = a.period / steps
            for n in range(1, steps + 1):
                c = coefficients(a, w)
                v, then = y[V], t + n * step
                if states:
                    advance_effects(then - step, y, measured.mode, Imposed(c, slope), step, 1, measured.work)
                if n == steps:
                    set_sample(k + 1, a, y, w)
                elif not states:
                    for i in range(FRICTION):
                        y[i] += step * slope[i]
                extra = inputs.extra[k] + (inputs.extra[k + 1] - inputs.extra[k]) * (n / steps)
                c = coefficients(a, w)
                level_then, applied_then = balance(extra, then, y, z, c)
                level_rate, applied_rate = (level_then - level) / step, (applied_then - applied) / step
                interval = Interval(a.friction, v, slope[V], level, level_rate, applied, applied_rate)
                advance(0.0, forces, mode, interval, step, 1, own.work)
                level, applied = level_then, applied_then

    return Body(run_samples, FRICTION + states, own=elements)
