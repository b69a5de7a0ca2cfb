"""A load parted from the piston, simulated from the load pressure.

Its motion is not measured. Piston and load move by the simulator's own equations under the recorded pressure, and the piston
is drawn to where it was measured.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel, lean
from ehls_ros.physics.along.base import Along, Scratch, lead, scratch, take
from ehls_ros.physics.composition import Switched
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.plant import FRICTION, PL, XV, Chains, Coefficients, U, V, X, balance_with, relations

MOST_EVENTS = 4
"""Events located within a step; a contact that chatters more densely is stepped over."""

NARROWEST, WIDEST, HALVINGS = 1e-6, 1.0, 40
"""Where the load is looked for around the piston when a stretch begins [m], and how often the interval is halved."""


class Piston(NamedTuple):
    """The piston's side of what parts it from the load.

    Attributes:
        parting: the effect that parts them, alone; :class:`~ehls_ros.physics.along.base.Along` has the others.
        state: where the effects' own states hold how far the piston is ahead of the load; its velocity is the next.
        mass: of the piston [kg].
        guide: how fast it is drawn to where it was measured [rad/s].
    """

    parting: Switched
    state: int
    mass: float
    guide: float


class Guided(NamedTuple):
    """What the equations take between two samples.

    Attributes:
        coefficients: of the simulator's equations.
        slope: rates of the measured states, shape (4,).
        start: time of the sample [s].
        position: of the piston as measured there [m].
        velocity: likewise [m/s].
        piston: its side.
    """

    coefficients: Coefficients
    slope: Array
    start: float
    position: float
    velocity: float
    piston: Piston


class Parted(NamedTuple):
    """The compiled part: ``run(a, piston, out)`` writes the columns that :mod:`ehls_ros.physics.along` lists."""

    run: Callable[..., None]


def build(friction: Any, elements: int, states: int, chains: Chains) -> Parted:
    """Build the part for a friction model's file, its number of forces, and the effects with their number of states."""
    end = FRICTION + elements
    equations, handed_on = relations(chains), chains.handed_on
    extra, memory, balance = equations.extra, equations.memory, balance_with(friction, chains)
    rates, force, event, change, begin = friction.rates, friction.force, friction.event, friction.switch, friction.begin

    @lean
    def handed(t: float, y: Array, c: Guided) -> float:
        """Return the force on the load by the piston, less the pressure's and the piston's weight [N]."""
        given = c.coefficients
        return handed_on(0.0, t, y, given.inputs, y[end:], c.piston.parting, given.plant)

    @lean
    def evaluate(t: float, y: Array, mode: Array, c: Guided, rate: Array) -> float:
        z, given, piston, plant = y[end:], c.coefficients, c.piston, c.coefficients.plant
        pushed = handed(t, y, c)
        level, applied = balance(extra(t, y, z, given) + pushed, t, y, z, given)
        resisting = force(y[V], applied, level, y[FRICTION:end], mode, given.friction)
        rate[X] = y[V]
        rate[V] = (applied - resisting) / plant.moving_mass  # (3)
        rate[PL], rate[XV] = c.slope[PL], c.slope[XV]
        rates(y[V], level, y[FRICTION:end], mode, given.friction, rate[FRICTION:end])  # (6), (8)
        memory(t, y, z, given, rate[end:])
        place, ahead = end + piston.state, t - c.start
        slower = c.velocity + ahead * c.slope[V] - y[place + 1]
        behind = c.position + ahead * c.slope[X] - (y[X] + y[place])
        drawn = piston.guide * (2.0 * slower + piston.guide * behind) * (piston.mass + plant.moving_mass)
        rate[place] = y[place + 1] - y[V]
        rate[place + 1] = (drawn - pushed) / piston.mass - plant.gravity
        return event(y[V], applied, level, y[FRICTION:end], mode, given.friction)

    @lean
    def switch(t: float, y: Array, mode: Array, c: Guided) -> None:
        z, given = y[end:], c.coefficients
        level, applied = balance(extra(t, y, z, given) + handed(t, y, c), t, y, z, given)
        y[V] = change(y[V], applied, level, y[FRICTION:end], mode, given.friction)

    advance = integrator(evaluate, switch, size=end + states, most_events=MOST_EVENTS, order=2)

    @lean
    def surplus(ahead: float, t: float, y: Array, c: Guided) -> float:
        """Return the force on a piston that is ahead of the load by so much, both at its velocity [N]."""
        place = end + c.piston.state
        y[X], y[place], y[place + 1] = c.position - ahead, ahead, c.velocity
        return -handed(t, y, c) - c.piston.mass * c.coefficients.plant.gravity

    @lean
    def settle(t: float, y: Array, c: Guided) -> None:
        """Lay the load where the piston hands on what the pressure pushes it with."""
        wide = NARROWEST
        while wide < WIDEST and not (surplus(-wide, t, y, c) > 0.0 > surplus(wide, t, y, c)):
            wide *= 4.0
        low, high = -wide, wide
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if surplus(middle, t, y, c) < 0.0:
                high = middle
            else:
                low = middle
        surplus(0.5 * (low + high), t, y, c)

    @lean
    def go(a: Along, piston: Piston, s: Scratch, sample: Array, out: Array) -> None:
        y, mode, w, slope, m = s.y, s.mode, s.w, s.slope, a.motion
        for k in range(m.time.size):
            take(k, a, sample, w)
            lead(k, a, slope)
            t = m.time[k]
            given = Coefficients(a.plant, a.friction, w, a.effects, w[U])
            c = Guided(given, slope, t, sample[X], sample[V], piston)
            y[PL], y[XV] = sample[PL], sample[XV]
            if a.fresh[k]:
                y[V] = sample[V]
                y[end:] = 0.0
                mode[:] = 0.0
                settle(t, y, c)
            level, others = balance(extra(t, y, y[end:], given), t, y, y[end:], given)
            applied = others + handed(t, y, c)
            if a.fresh[k]:
                inertia = a.friction.viscous_coefficient * y[V] + a.plant.moving_mass * slope[V]
                begin(applied - inertia, level, a.friction, y[FRICTION:end])
            out[k, 0], out[k, 1] = y[X], y[V]
            out[k, 2] = force(y[V], applied, level, y[FRICTION:end], mode, a.friction)
            # In the sum of both balances the force between them drops out.
            out[k, 3] = others - piston.mass * a.plant.gravity
            advance(t, y, mode, c, a.period / a.steps, a.steps, s.work)

    @kernel
    def run(a: Along, piston: Piston, out: Array) -> None:
        go(a, piston, scratch(end + states, elements, a.history), np.zeros(FRICTION), out)

    return Parted(run)
