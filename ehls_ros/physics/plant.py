"""The plant: equations (1)-(4) and a friction model, as one switching system for the integrator.

State ``y``: piston position, velocity, load pressure, spool displacement (x1..x4 of (24)), then the
friction model's forces, then the effects' own states. Modes: the side the orifice is open to, then the
friction model's.

:func:`system` builds it from a friction model and the effects' hooks; the compiler inlines them, so what no
effect uses costs nothing.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.beam import applied_force
from ehls_ros.physics.cylinder import load_pressure_rate
from ehls_ros.physics.friction.base import stribeck_level
from ehls_ros.physics.parameters import Friction, Plant
from ehls_ros.physics.valve import load_flow, spool_rate

X, V, PL, XV, FRICTION = 0, 1, 2, 3, 4
"""Where the state holds position, velocity, load pressure, spool; and where the friction forces start."""

U, FD, FD_RATE, XD, VD, TEMPERATURE, START, INPUTS = 0, 1, 2, 3, 4, 5, 6, 7
"""Inputs ``w``: spool command [m], disturbance force [N] and its rate [N/s], displacement [m] and velocity
[m/s] of the position servo, oil temperature [K], time the inputs were taken at [s]; and their number."""


class Coefficients(NamedTuple):
    """What the equations need besides state and inputs."""

    plant: Plant
    friction: Friction
    inputs: Array
    effects: Array


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
    """The chosen parts of a plant: a friction model's file and one function a hook."""

    friction: Any
    elements: int
    command: Callable[..., float]
    opening: Callable[..., float]
    supply_pressure: Callable[..., float]
    bulk_modulus: Callable[..., float]
    leakage: Callable[..., float]
    friction_level: Callable[..., float]
    force: Callable[..., float]
    effect_rates: Callable[..., None]


def system(parts: Parts) -> tuple[Callable[..., float], Callable[..., None]]:
    """Build the plant of chosen parts.

    Returns:
        ``evaluate`` and ``switch`` as :mod:`ehls_ros.physics.integration` wants them.
    """
    end = FRICTION + parts.elements
    friction_rates, friction_force = parts.friction.rates, parts.friction.force
    friction_event, friction_switch = parts.friction.event, parts.friction.switch
    command, opening, supply_pressure = parts.command, parts.opening, parts.supply_pressure
    bulk_modulus, leakage, friction_level = parts.bulk_modulus, parts.leakage, parts.friction_level
    extra_force, effect_rates = parts.force, parts.effect_rates

    @kernel
    def mechanics(t: float, y: Array, c: Coefficients) -> tuple[float, float]:
        """Return the Stribeck level s(v) and the force on the mass without friction [N]."""
        w, z, p = c.inputs, y[end:], c.effects
        level = friction_level(stribeck_level(y[V], c.friction), t, y, w, z, p)  # (7)
        extra = extra_force(0.0, t, y, w, z, p)
        applied = applied_force(y[X], y[V], y[PL], disturbance_force(t, w), extra, c.plant)
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
        spool = opening(y[XV], t, y, w, z, p)
        supply = supply_pressure(plant.supply_pressure, t, y, w, z, p)
        flow = load_flow(spool, mode[0], y[PL], supply, plant)  # (1)
        leak = leakage(0.0, t, y, w, z, p)
        modulus = bulk_modulus(plant.bulk_modulus, t, y, w, z, p)

        rate[X] = y[V]
        rate[V] = (applied - friction) / plant.moving_mass  # (3)
        rate[PL] = load_pressure_rate(flow, y[V], y[PL], leak, modulus, plant)  # (2)
        rate[XV] = spool_rate(y[XV], command(w[U], t, y, w, z, p), plant)  # (4)
        friction_rates(y[V], level, y[FRICTION:end], mode[1:], c.friction, rate[FRICTION:end])  # (6), (8)
        effect_rates(t, y, w, z, p, rate[end:])

        changed = friction_event(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)
        return max(-mode[0] * spool, changed)

    @kernel
    def switch(t: float, y: Array, mode: Array, c: Coefficients) -> None:
        """Change the modes whose event has come."""
        if -mode[0] * opening(y[XV], t, y, c.inputs, y[end:], c.effects) > 0.0:
            mode[0] = -mode[0]
        level, applied = mechanics(t, y, c)
        y[V] = friction_switch(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)

    return evaluate, switch
