"""Simulate a load separated from the piston by play or elasticity, from the load pressure.

The load's motion is not measured. Piston and load follow the simulator's equations under the recorded pressure, and the piston
tracks its measured position.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.duals import dual_array, joined, value_of
from ehls_ros.physics.composition import Switched
from ehls_ros.physics.imposed_motion.base import Body, ModelRun, Scratch, coefficients, set_sample, write_slopes
from ehls_ros.physics.integration import integrator
from ehls_ros.physics.plant import (
    FRICTION,
    PL,
    XV,
    Chains,
    Coefficients,
    V,
    X,
    balance_with,
    break_away_with,
    motion,
    relations,
)

MAX_EVENTS = 4
"""Most events located within a step; further ones of a chattering contact are not located."""

NARROWEST, WIDEST, HALVINGS = 1e-6, 1.0, 40
"""Search for the load's initial position: smallest and largest distance from the piston [m]; number of bisections."""


class Piston(NamedTuple):
    """The piston and its joint to the load.

    Attributes:
        joint: the effect between piston and load alone; the others are in
            :class:`~ehls_ros.physics.imposed_motion.base.ModelRun`.
        state: index, among the effects' states, of the displacement of the piston relative to the load. The next state is the
            piston's velocity.
        mass: mass of the piston [kg].
        tracking_rate: natural frequency at which it tracks its measured position, critically damped [rad/s].
    """

    joint: Switched
    state: int
    mass: float
    tracking_rate: float

    @property
    def varied(self) -> tuple[Any, ...]:
        """Arrays that may be duals."""
        return self.joint.values, joined([self.mass])

    @property
    def values_alone(self) -> "Piston":
        """The piston without derivatives."""
        return self._replace(joint=Switched(self.joint.on, value_of(self.joint.values)), mass=value_of(self.mass))


def of_duals(width: int) -> Callable[..., Piston]:
    """Build the function that returns the piston as duals, from the rows of :attr:`Piston.varied`."""

    @kernel
    def inputs_of(piston: Piston, rows: tuple[Array, Array]) -> Piston:
        joint = Switched(piston.joint.on, dual_array(rows[0], width))
        return Piston(joint, piston.state, dual_array(rows[1], width)[0], piston.tracking_rate)

    return inputs_of


class Interval(NamedTuple):
    """Coefficients of the equations between two samples.

    Attributes:
        coefficients: coefficients of the simulator's equations.
        slope: rates of the measured states, shape (4,).
        start: time of the first sample [s].
        position: measured piston position at that time [m].
        velocity: measured piston velocity at that time [m/s].
        piston: the piston and its joint.
    """

    coefficients: Coefficients
    slope: Array
    start: float
    position: float
    velocity: float
    piston: Piston


def build(friction: Any, elements: int, states: int, chains: Chains) -> Body:
    """Build the part, which writes the columns of :mod:`ehls_ros.physics.imposed_motion`; its input is the :class:`Piston`.

    Args:
        friction: module of the friction model.
        elements: number of the model's forces.
        states: number of the effects' states.
        chains: hooks of the effects.
    """
    end = FRICTION + elements
    equations, joint_chain = relations(chains), chains.joint_force
    extra, effect_rates, balance = equations.extra, equations.effect_rates, balance_with(friction, chains)
    move, reverse = motion(friction, elements, chains)
    force, begin, break_away = friction.force, friction.begin, break_away_with(friction)

    @kernel_no_refcount
    def joint_force(t: float, y: Array, c: Interval) -> float:
        """Return the joint's force on the load minus the pressure force and the piston's weight [N]."""
        given = c.coefficients
        return joint_chain(0.0, t, y, given.inputs, y[end:], c.piston.joint, given.plant)

    @kernel_no_refcount
    def evaluate(t: float, y: Array, mode: Array, c: Interval, rate: Array) -> float:
        z, given, piston, plant = y[end:], c.coefficients, c.piston, c.coefficients.plant
        from_joint = joint_force(t, y, c)
        changed = move(extra(t, y, z, given) + from_joint, t, y, z, mode, given, rate)  # (3), (6), (8)
        rate[PL], rate[XV] = c.slope[PL], c.slope[XV]
        effect_rates(t, y, z, given, rate[end:])
        i, since = end + piston.state, t - c.start
        velocity_error = c.velocity + since * c.slope[V] - y[i + 1]
        position_error = c.position + since * c.slope[X] - (y[X] + y[i])
        tracking = piston.tracking_rate * (2.0 * velocity_error + piston.tracking_rate * position_error)
        tracking_force = tracking * (piston.mass + plant.moving_mass)
        rate[i] = y[i + 1] - y[V]
        rate[i + 1] = (tracking_force - from_joint) / piston.mass - plant.gravity
        return changed

    @kernel_no_refcount
    def switch(t: float, y: Array, mode: Array, c: Interval) -> None:
        z, given = y[end:], c.coefficients
        reverse(extra(t, y, z, given) + joint_force(t, y, c), t, y, z, mode, given)

    advance = integrator(evaluate, switch, size=end + states, most_events=MAX_EVENTS, order=2)

    @kernel_no_refcount
    def piston_force(ahead: float, t: float, y: Array, c: Interval) -> float:
        """Return the force [N] on a piston ``ahead`` [m] of the load without relative velocity; this sets the state."""
        i = end + c.piston.state
        y[X], y[i], y[i + 1] = c.position - ahead, ahead, c.velocity
        return -joint_force(t, y, c) - c.piston.mass * c.coefficients.plant.gravity

    @kernel_no_refcount
    def settle(t: float, y: Array, c: Interval) -> None:
        """Place the load so that the joint transmits the pressure force, by bisection."""
        wide = NARROWEST
        while wide < WIDEST and not (piston_force(-wide, t, y, c) > 0.0 > piston_force(wide, t, y, c)):
            wide *= 4.0
        low, high = -wide, wide
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if piston_force(middle, t, y, c) < 0.0:
                high = middle
            else:
                low = middle
        piston_force(0.5 * (low + high), t, y, c)

    @kernel_no_refcount
    def run_samples(a: ModelRun, piston: Piston, s: Scratch, own: Scratch, out: Array) -> None:
        y, mode, w, slope, m, sample = s.y, s.mode, s.w, s.slope, a.motion, own.y
        for k in range(m.time.size):
            set_sample(k, a, sample, w)
            write_slopes(k, a, slope)
            t = m.time[k]
            given = coefficients(a, w)
            c = Interval(given, slope, t, sample[X], sample[V], piston)
            y[PL], y[XV] = sample[PL], sample[XV]
            if a.fresh[k]:
                y[V] = sample[V]
                y[end:] = 0.0
                mode[:] = 0.0
                settle(t, y, c)
            level, others = balance(extra(t, y, y[end:], given), t, y, y[end:], given)
            applied = others + joint_force(t, y, c)
            if a.fresh[k]:
                inertia = a.friction.viscous_coefficient * y[V] + a.plant.moving_mass * slope[V]
                begin(applied - inertia, break_away(level, y[V], a.friction), a.friction, y[FRICTION:end])
            out[k, 0], out[k, 1] = y[X], y[V]
            out[k, 2] = force(y[V], applied, level, y[FRICTION:end], mode, a.friction)
            # The joint's force cancels in the sum of both balances.
            out[k, 3] = others - piston.mass * a.plant.gravity
            advance(t, y, mode, c, a.period / a.steps, a.steps, s.work)

    return Body(run_samples, end + states, elements, own=FRICTION)
