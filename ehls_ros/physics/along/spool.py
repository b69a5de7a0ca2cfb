"""The spool (4) simulated from the recorded command."""

import math
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, lean
from ehls_ros.physics.along.base import Along, Imposed, Sampled, Scratch, lead, never, scratch, take
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import FRICTION, PL, XV, Chains, Coefficients, V, X, mover, relations


class _Following(NamedTuple):
    """What stands between two samples; see :class:`~ehls_ros.physics.along.base.Along`."""

    plant: Plant
    friction: Any
    inputs: Array
    effects: Any
    slope: Array


def build(states: int, chains: Chains) -> Sampled:
    """Build the part.

    Its ``run(a, out)`` writes the spool displacement [m], shape (n, 1). Without ``a.steps``, where no effect remembers
    anything, commands stand still between their jumps and (4) is followed exactly.
    """
    equations, command = relations(chains), chains.command
    rates, spool = equations.memory, equations.spool

    @lean
    def evaluate(t: float, y: Array, mode: Array, c: Imposed, rate: Array) -> float:
        rate[X], rate[V], rate[PL] = c.slope[X], c.slope[V], c.slope[PL]
        rate[XV] = spool(t, y, y[FRICTION:], c.coefficients)  # (4)
        rates(t, y, y[FRICTION:], c.coefficients, rate[FRICTION:])
        return -1.0

    integrate = integrator(evaluate, never, size=FRICTION + states)

    @lean
    def stepped(t: float, y: Array, mode: Array, c: _Following, arrived: float, step: float, steps: int, work: Array) -> int:
        given = Imposed(Coefficients(c.plant, c.friction, c.inputs, c.effects, arrived), c.slope)
        return integrate(t, y, mode, given, step, steps, work)

    @lean
    def exact(t: float, y: Array, mode: Array, c: _Following, arrived: float, step: float, steps: int, work: Array) -> int:
        held = c.plant.valve_gain * command(arrived, t, y, c.inputs, y[FRICTION:], c.effects, c.plant)
        y[XV] = held + (y[XV] - held) * math.exp(-c.plant.valve_bandwidth * step * steps)  # (4)
        return 0

    move_stepped, move_exact = mover(stepped, chains, FRICTION), mover(exact, chains, FRICTION)

    @lean
    def go(a: Along, s: Scratch, out: Array) -> None:
        y, w, slope = s.y, s.w, s.slope
        for k in range(a.motion.time.size):
            reached = y[XV]
            take(k, a, y, w)
            if a.fresh[k]:
                y[FRICTION:] = 0.0
            else:
                y[XV] = reached
            out[k, 0] = y[XV]
            t, c = a.motion.time[k], _Following(a.plant, a.friction, w, a.effects, slope)
            if a.steps:
                lead(k, a, slope)
                move_stepped(t, y, s.mode, c, a.period / a.steps, a.steps, s.work)
            else:
                move_exact(t, y, s.mode, c, a.period, 1, s.work)

    @kernel
    def run(a: Along, out: Array) -> None:
        go(a, scratch(FRICTION + states, 0, a.history), out)

    return Sampled(run)
