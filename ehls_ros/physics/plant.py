"""The plant: equations (1)-(4) and a friction model, as one switching system for the integrator.

State ``y``: position and velocity of the moving mass (the piston's, unless an effect parts load and piston), load
pressure, spool displacement (x1..x4 of (24)), then the friction model's forces, then the effects' own states.
Modes: the side the orifice is open to, then the friction model's.

:func:`system` builds it from a friction model and the effects' hooks; the compiler inlines them, so what no
effect uses costs nothing.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.beam import applied_force
from ehls_ros.physics.cylinder import load_pressure_rate
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.valve import load_flow, spool_rate

X, V, PL, XV, FRICTION = 0, 1, 2, 3, 4
"""Where the state holds position, velocity, load pressure, spool; and where the friction forces start."""

U, FD, FD_RATE, XD, VD, TEMPERATURE, START, PERIOD, INPUTS = 0, 1, 2, 3, 4, 5, 6, 7, 8
"""Inputs ``w``: spool command [m], disturbance force [N] and its rate [N/s], displacement [m] and velocity
[m/s] of the position servo, oil temperature [K], time the inputs were taken at [s], control period [s]; and
their number. Where an effect looks back, the commands sent before follow: ``w[INPUTS + i]`` is the one sent i + 1
cycles before the present; zero before the first."""


class Coefficients(NamedTuple):
    """What the equations need besides state and inputs; ``command`` is the one that has arrived at the valve [m]."""

    plant: Plant
    friction: Any
    inputs: Array
    effects: Array
    command: float


@kernel
def hold(w: Array, start: float, command: float, force: float, force_rate: float, displacement: float, velocity: float) -> None:
    """Take the inputs of a new cycle.

    Args:
        w: inputs, changed in place.
        start: time at which the cycle begins [s].
        command: spool command, held [m].
        force: disturbance force now [N].
        force_rate: and its rate [N/s].
        displacement: displacement of the position servo now [m].
        velocity: and its velocity [m/s].
    """
    for i in range(w.size - 1, INPUTS, -1):
        w[i] = w[i - 1]
    if w.size > INPUTS:
        w[INPUTS] = w[U]
    w[U], w[FD], w[FD_RATE], w[XD], w[VD], w[START] = command, force, force_rate, displacement, velocity, start


@kernel
def disturbance_force(t: float, w: Array) -> float:
    """Return fd(t) [N]: between two cycles it goes on at its rate."""
    return w[FD] + w[FD_RATE] * (t - w[START])


@kernel
def servo_displacement(t: float, w: Array) -> float:
    """Return the position servo's displacement at t [m]."""
    return w[XD] + w[VD] * (t - w[START])


@kernel
def servo_velocity(w: Array) -> float:
    """Return the position servo's velocity [m/s]."""
    return w[VD]


class Parts(NamedTuple):
    """The chosen parts of a plant: a friction model's file and one function a hook; no ``received`` without delay."""

    friction: Any
    elements: int
    received: Callable[..., float] | None
    jump: Callable[..., float] | None
    command: Callable[..., float]
    opening: Callable[..., float]
    supply_pressure: Callable[..., float]
    bulk_modulus: Callable[..., float]
    leakage: Callable[..., float]
    friction_level: Callable[..., float]
    force: Callable[..., float]
    piston_velocity: Callable[..., float]
    effect_rates: Callable[..., None]


def system(parts: Parts) -> tuple[Callable[..., float], Callable[..., None]]:
    """Build the plant of chosen parts.

    Returns:
        ``evaluate`` and ``switch`` as :mod:`ehls_ros.physics.integration` wants them.
    """
    end = FRICTION + parts.elements
    sliding_level = parts.friction.level
    friction_rates, friction_force = parts.friction.rates, parts.friction.force
    friction_event, friction_switch = parts.friction.event, parts.friction.switch
    command, opening, supply_pressure = parts.command, parts.opening, parts.supply_pressure
    bulk_modulus, leakage, friction_level = parts.bulk_modulus, parts.leakage, parts.friction_level
    extra_force, piston_velocity, effect_rates = parts.force, parts.piston_velocity, parts.effect_rates

    @kernel
    def mechanics(t: float, y: Array, c: Coefficients) -> tuple[float, float]:
        """Return the Stribeck level s(v) and the force on the mass without friction [N]."""
        w, z, p, plant = c.inputs, y[end:], c.effects, c.plant
        level = friction_level(sliding_level(y[V], c.friction), t, y, w, z, p, plant)  # (7)
        extra = extra_force(0.0, t, y, w, z, p, plant)
        applied = applied_force(y[X], y[V], y[PL], disturbance_force(t, w), extra, plant)
        return level, applied

    @kernel
    def evaluate(t: float, y: Array, mode: Array, c: Coefficients, rate: Array) -> float:
        """Write dy/dt of (24) with the effects at their places.

        Returns:
            What is positive once the orifice has changed sides or a friction mode has to change.
        """
        plant, w, z, p = c.plant, c.inputs, y[end:], c.effects
        level, applied = mechanics(t, y, c)
        friction = friction_force(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)
        spool = opening(y[XV], t, y, w, z, p, plant)
        supply = supply_pressure(plant.supply_pressure, t, y, w, z, p, plant)
        flow = load_flow(spool, mode[0], y[PL], supply, plant)  # (1)
        leak = leakage(0.0, t, y, w, z, p, plant)
        modulus = bulk_modulus(plant.bulk_modulus, t, y, w, z, p, plant)

        rate[X] = y[V]
        rate[V] = (applied - friction) / plant.moving_mass  # (3)
        piston = piston_velocity(y[V], t, y, w, z, p, plant)
        rate[PL] = load_pressure_rate(flow, piston, y[PL], leak, modulus, plant)  # (2)
        rate[XV] = spool_rate(y[XV], command(c.command, t, y, w, z, p, plant), plant)  # (4)
        friction_rates(y[V], level, y[FRICTION:end], mode[1:], c.friction, rate[FRICTION:end])  # (6), (8)
        effect_rates(c.command, t, y, w, z, p, plant, rate[end:])

        changed = friction_event(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)
        return max(-mode[0] * spool, changed)

    @kernel
    def switch(t: float, y: Array, mode: Array, c: Coefficients) -> None:
        """Change the modes whose event has come."""
        if -mode[0] * opening(y[XV], t, y, c.inputs, y[end:], c.effects, c.plant) > 0.0:
            mode[0] = -mode[0]
        level, applied = mechanics(t, y, c)
        y[V] = friction_switch(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)

    return evaluate, switch


JUMP_TOLERANCE = 1e-6
"""How near two jumps of the command are one, as a part of the step."""


def mover(run: Callable[..., int], parts: Parts) -> Callable[..., int]:
    """Build what moves the plant on under inputs held.

    Args:
        run: integrator of the plant's :func:`system`.
        parts: the plant's parts.

    Returns:
        ``move(t, y, mode, plant, friction, inputs, effects, step, steps, work)``, the number of steps in which events came
        too densely. Where commands arrive late, it integrates from jump to jump, in steps no longer than ``step``.
    """
    end = FRICTION + parts.elements

    @kernel
    def move(
        t: float,
        y: Array,
        mode: Array,
        plant: Plant,
        friction: Any,
        inputs: Array,
        effects: Array,
        step: float,
        steps: int,
        work: Array,
    ) -> int:
        c = Coefficients(plant, friction, inputs, effects, inputs[U])
        return run(t, y, mode, c, step, steps, work)

    if parts.received is None or parts.jump is None:
        return move
    received, jump = parts.received, parts.jump

    @kernel
    def move_late(
        t: float,
        y: Array,
        mode: Array,
        plant: Plant,
        friction: Any,
        inputs: Array,
        effects: Array,
        step: float,
        steps: int,
        work: Array,
    ) -> int:
        dense, now, whole = 0, t, steps * step
        last, tolerance = t + whole, JUMP_TOLERANCE * step
        while last - now > tolerance:
            until = min(jump(now + tolerance, inputs, effects), last)
            # Asked amid the piece, where no rounding can take it past a jump.
            command = received(inputs[U], 0.5 * (now + until), y, inputs, y[end:], effects, plant)
            c = Coefficients(plant, friction, inputs, effects, command)
            length = until - now
            pieces = math.ceil(length / step - JUMP_TOLERANCE)
            # Without a jump the steps are to the bit those of an undelayed plant.
            dense += run(now, y, mode, c, step if length > whole - tolerance else length / pieces, pieces, work)
            now = until
        return dense

    return move_late
