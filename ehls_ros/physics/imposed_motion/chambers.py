"""The terms of both chambers' balances along a recording, and the supply pressure at the valve."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.duals import dual_array, dual_record, joined, value_of, values_of
from ehls_ros.physics.imposed_motion.base import Body, Imposed, ModelRun, Scratch, effect_integrator, set_sample, write_slopes
from ehls_ros.physics.plant import FRICTION, Chains, Coefficients, U, relations


class Chambers(NamedTuple):
    """Inputs of the part besides the recording.

    Attributes:
        a, b: pressures of the chambers, shape (n,) [Pa].
        supply: measured supply pressure, shape (n,) [Pa].
        measured: whether it is measured.
        cylinder, valve: their ``Parameters``.
    """

    a: Array
    b: Array
    supply: Array
    measured: bool
    cylinder: Any
    valve: Any

    @property
    def varied(self) -> tuple[Any, ...]:
        """Arrays that may be duals."""
        return self.a, self.b, self.supply, joined(self.cylinder), joined(self.valve)

    @property
    def values_alone(self) -> "Chambers":
        """The inputs without derivatives."""
        a, b, supply = (value_of(signal) for signal in (self.a, self.b, self.supply))
        return Chambers(a, b, supply, self.measured, values_of(self.cylinder), values_of(self.valve))


def of_duals(width: int) -> Callable[..., Chambers]:
    """Build the function that returns the inputs as duals, from the rows of :attr:`Chambers.varied`."""

    @kernel
    def inputs_of(inputs: Chambers, rows: tuple[Array, Array, Array, Array, Array]) -> Chambers:
        return Chambers(
            dual_array(rows[0], width),
            dual_array(rows[1], width),
            dual_array(rows[2], width),
            inputs.measured,
            dual_record(rows[3], width, inputs.cylinder),
            dual_record(rows[4], width, inputs.valve),
        )

    return inputs_of


def build(states: int, chains: Chains, cylinder: Any, valve: Any) -> Body:
    """Build the part, which writes the columns of :mod:`ehls_ros.physics.imposed_motion`; its inputs are :class:`Chambers`.

    The supply pressure follows the flow with its lag, exactly for a flow that is linear between samples. The valve gets the
    measured one where there is one.

    Args:
        states: number of the effects' states.
        chains: hooks of the effects.
        cylinder: module of the cylinder.
        valve: module of the valve.
    """
    equations = relations(chains)
    effective_opening, advance = equations.effective_opening, effect_integrator(equations, states)
    terms_at = cylinder.terms(valve, chains)

    @kernel_no_refcount
    def run_samples(a: ModelRun, inputs: Chambers, s: Scratch, own: Scratch, out: Array) -> None:
        y, w, slope, p, supply, measured = s.y, s.w, s.slope, inputs.cylinder, own.y, inputs.measured
        kept = math.exp(-a.period / p.supply_time_constant)
        followed = 1.0 - (1.0 - kept) * p.supply_time_constant / a.period
        for k in range(a.motion.time.size):
            set_sample(k, a, y, w)
            if a.fresh[k]:
                y[FRICTION:] = 0.0
            t, z = a.motion.time[k], y[FRICTION:]
            c = Coefficients(a.plant, a.friction, w, a.effects, w[U], p, inputs.valve)
            opening, first, second = effective_opening(t, y, z, c), inputs.a[k], inputs.b[k]
            # supply[0]: at the valve; supply[1]: to which it tends; supply[2]: at which the flow is taken.
            if a.fresh[k]:
                supply[0] = inputs.supply[k] if measured else a.plant.supply_pressure
            supply[2] = inputs.supply[k] if measured else supply[0]
            of = terms_at(opening, supply[2], first, second, t, y, z, c)
            tends = a.plant.supply_pressure - p.supply_resistance * of.supplied
            if not a.fresh[k]:
                supply[0] = supply[1] + (supply[0] - supply[1]) * kept + (tends - supply[1]) * followed
                if not measured:
                    of = terms_at(opening, supply[0], first, second, t, y, z, c)
                    tends = a.plant.supply_pressure - p.supply_resistance * of.supplied
            supply[1] = tends
            row = out[k]
            row[0], row[1], row[2], row[3] = of.flow_a, of.flow_b, of.lost_a, of.lost_b
            row[4], row[5], row[6] = of.modulus_a, of.modulus_b, supply[0]
            if a.steps:
                write_slopes(k, a, slope)
                advance(t, y, s.mode, Imposed(c, slope), a.period / a.steps, a.steps, s.work)

    return Body(run_samples, FRICTION + states, own=3)
