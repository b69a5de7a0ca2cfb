"""A friction model run along a recorded motion."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, lean
from ehls_ros.physics.along.base import Along, Imposed, Scratch, lead, memory, scratch, take
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.plant import FRICTION, Chains, Coefficients, U, V, balance_with, relations

STEEP, FINE = 0.1, 6
"""Change of the velocity within a sample, in speed and Stribeck velocity together, above which the Stribeck curve is too steep
for a straight line; and the pieces such a sample is cut into."""

TINY = 1e-300
"""A speed that counts as reversed, and as nothing else [m/s]."""


class Begun(NamedTuple):
    """What the part takes of others.

    Attributes:
        extra: force of the effects beyond (3), shape (n,) [N].
        balance: friction that the other forces ask for, used where a stretch begins, shape (n,) [N].
        slow: velocity over which the level of steady sliding changes; infinite where it does not change [m/s].
    """

    extra: Array
    balance: Array
    slow: float


class Contact(NamedTuple):
    """What a friction model meets between two moments, all straight lines in the time since the first.

    Attributes:
        friction: its parameters.
        velocity: at the first [m/s].
        acceleration: its rate [m/s^2].
        level: Stribeck level at the first [N].
        level_rate: its rate [N/s].
        applied: every other force on the mass at the first [N].
        applied_rate: its rate [N/s].
    """

    friction: Any
    velocity: float
    acceleration: float
    level: float
    level_rate: float
    applied: float
    applied_rate: float


class Rubbing(NamedTuple):
    """The compiled part.

    Attributes:
        run: ``run(a, begun, out)`` writes the friction force [N], shape (n, 1).
    """

    run: Callable[..., None]


def contact(friction: Any, elements: int) -> Callable[..., int]:
    """Build the integrator of a friction model's forces under a :class:`Contact`.

    Args:
        friction: the friction model's file.
        elements: number of its forces.

    Returns:
        ``advance`` of :func:`~ehls_ros.physics.integration.integrator`, the forces its state.
    """
    rates, event, change = friction.rates, friction.event, friction.switch

    @lean
    def evaluate(t: float, y: Array, mode: Array, c: Contact, rate: Array) -> float:
        v, level = c.velocity + c.acceleration * t, c.level + c.level_rate * t
        rates(v, level, y, mode, c.friction, rate)  # (6), (8)
        return event(v, c.applied + c.applied_rate * t, level, y, mode, c.friction)

    @lean
    def switch(t: float, y: Array, mode: Array, c: Contact) -> None:
        v, level = c.velocity + c.acceleration * t, c.level + c.level_rate * t
        change(v, c.applied + c.applied_rate * t, level, y, mode, c.friction)

    return integrator(evaluate, switch, size=elements, order=2)


def build(friction: Any, elements: int, states: int, chains: Chains) -> Rubbing:
    """Build the part for a friction model's file, its number of forces, and the effects with their number of states."""
    balance, remember = balance_with(friction, chains), memory(relations(chains), states)
    advance, force, change, begin = contact(friction, elements), friction.force, friction.switch, friction.begin

    @lean
    def go(a: Along, begun: Begun, measured: Scratch, own: Scratch, out: Array) -> None:
        y, w, slope, forces, mode = measured.y, measured.w, measured.slope, own.y, own.mode
        last = a.motion.time.size - 1
        level, applied = 0.0, 0.0
        take(0, a, y, w)
        for k in range(last + 1):
            t, z = a.motion.time[k], y[FRICTION:]
            if a.fresh[k]:
                z[:] = 0.0
                mode[:] = 0.0
                level, applied = balance(begun.extra[k], t, y, z, Coefficients(a.plant, a.friction, w, a.effects, w[U]))
                begin(begun.balance[k], level, a.friction, forces)
                if y[V] != 0.0:
                    # It moves, whatever is applied.
                    change(y[V], math.copysign(math.inf, y[V]), level, forces, mode, a.friction)
            lead(k, a, slope)
            if y[V] == 0.0 and slope[V] == 0.0:
                # At rest; which way it moved before says what slipped until then.
                for i in range(elements):
                    if mode[i] != 0.0:
                        change(-mode[i] * TINY, applied, level, forces, mode, a.friction)
            out[k, 0] = force(y[V], applied, level, forces, mode, a.friction)
            if k == last:
                break
            steep = abs(slope[V]) * a.period > STEEP * (abs(y[V]) + begun.slow)
            parts = max(a.steps, FINE) if steep else a.steps
            step = a.period / parts
            for part in range(1, parts + 1):
                c = Coefficients(a.plant, a.friction, w, a.effects, w[U])
                v, then = y[V], t + part * step
                if states:
                    remember(then - step, y, measured.mode, Imposed(c, slope), step, 1, measured.work)
                if part == parts:
                    take(k + 1, a, y, w)
                elif not states:
                    for i in range(FRICTION):
                        y[i] += step * slope[i]
                extra = begun.extra[k] + (begun.extra[k + 1] - begun.extra[k]) * (part / parts)
                c = Coefficients(a.plant, a.friction, w, a.effects, w[U])
                level_then, applied_then = balance(extra, then, y, z, c)
                level_rate, applied_rate = (level_then - level) / step, (applied_then - applied) / step
                met = Contact(a.friction, v, slope[V], level, level_rate, applied, applied_rate)
                advance(0.0, forces, mode, met, step, 1, own.work)
                level, applied = level_then, applied_then

    @kernel
    def run(a: Along, begun: Begun, out: Array) -> None:
        go(a, begun, scratch(FRICTION + states, 0, a.history), scratch(elements, elements, 0), out)

    return Rubbing(run)
