"""Simulate the spool (4) from the recorded command."""

import math
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel_no_refcount
from ehls_ros.physics.imposed_motion.base import Body, Imposed, ModelRun, Scratch, no_switch, set_sample, write_slopes
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import FRICTION, PL, XV, Chains, Coefficients, V, X, cycle_stepper, relations


class _Interval(NamedTuple):
    """Constants between two samples, see :class:`~ehls_ros.physics.imposed_motion.base.ModelRun`."""

    plant: Plant
    friction: Any
    inputs: Array
    effects: Any
    slope: Array


def build(states: int, chains: Chains) -> Body:
    """Build the part, which writes the spool displacement [m]; its only input is the recording.

    With ``a.steps`` = 0, for effects without states, commands are constant between jumps and (4) is solved exactly.

    Args:
        states: number of the effects' states.
        chains: hooks of the effects.
    """
    equations, command = relations(chains), chains.command
    effect_rates, spool = equations.effect_rates, equations.spool

    @kernel_no_refcount
    def evaluate(t: float, y: Array, mode: Array, c: Imposed, rate: Array) -> float:
        rate[X], rate[V], rate[PL] = c.slope[X], c.slope[V], c.slope[PL]
        rate[XV] = spool(t, y, y[FRICTION:], c.coefficients)  # (4)
        effect_rates(t, y, y[FRICTION:], c.coefficients, rate[FRICTION:])
        return -1.0

    integrate = integrator(evaluate, no_switch, size=FRICTION + states)

    @kernel_no_refcount
    def stepped(t: float, y: Array, mode: Array, c: _Interval, arrived: float, step: float, steps: int, work: Array) -> int:
        given = Imposed(Coefficients(c.plant, c.friction, c.inputs, c.effects, arrived, (), ()), c.slope)
        return integrate(t, y, mode, given, step, steps, work)

    @kernel_no_refcount
    def exact(t: float, y: Array, mode: Array, c: _Interval, arrived: float, step: float, steps: int, work: Array) -> int:
        held = c.plant.valve_gain * command(arrived, t, y, c.inputs, y[FRICTION:], c.effects, c.plant)
        y[XV] = held + (y[XV] - held) * math.exp(-c.plant.valve_bandwidth * step * steps)  # (4)
        return 0

    step_numerically, step_exactly = cycle_stepper(stepped, chains, FRICTION), cycle_stepper(exact, chains, FRICTION)

    @kernel_no_refcount
    def run_samples(a: ModelRun, inputs: None, s: Scratch, own: Scratch, out: Array) -> None:
        y, w, slope = s.y, s.w, s.slope
        for k in range(a.motion.time.size):
            reached = y[XV]
            set_sample(k, a, y, w)
            if a.fresh[k]:
                y[FRICTION:] = 0.0
            else:
                y[XV] = reached
            out[k, 0] = y[XV]
            t, c = a.motion.time[k], _Interval(a.plant, a.friction, w, a.effects, slope)
            if a.steps:
                write_slopes(k, a, slope)
                step_numerically(t, y, s.mode, c, a.period / a.steps, a.steps, s.work)
            else:
                step_exactly(t, y, s.mode, c, a.period, 1, s.work)

    return Body(run_samples, FRICTION + states)
