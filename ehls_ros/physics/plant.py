"""The plant: equations (1)-(4) and a friction model, as one switching system for the integrator.

State ``y``: position and velocity of the moving mass (the piston's, unless an effect parts load and piston), load
pressure, spool displacement (x1..x4 of (24)), then the friction model's forces, then the effects' own states.
Modes: the side the orifice is open to, then the friction model's.

:func:`relations` builds the equations from the effects' hooks, :func:`system` the simulator's plant from these and a
friction model; the compiler inlines all of them, so what no effect uses costs nothing. What runs along a recording
(:mod:`ehls_ros.physics.along`) is built from the same relations.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, lean
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
    """What the equations need besides time and state.

    Attributes:
        plant: of the effective rig.
        friction: of the effective rig.
        inputs: ``w``.
        effects: ``p`` of the chains: the effects' parameters in a row, or
            :class:`~ehls_ros.physics.composition.Switched`.
        command: spool command that has arrived at the valve [m].
    """

    plant: Plant
    friction: Any
    inputs: Array
    effects: Any
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


class Chains(NamedTuple):
    """The hooks of several effects, each kind in a row: compiled ``hook(value, t, y, w, z, p, plant) -> value``.

    Arguments are those of :mod:`ehls_ros.physics.effects.base`, but ``z`` holds the states and ``p`` the parameters of all
    these effects. :mod:`ehls_ros.physics.composition` writes them.

    Attributes:
        received: as the hooks that follow; None where no effect delays the command.
        jump: ``jump(t, w, p)``, the time of the next jump of ``received`` after t [s]; None likewise.
        command: and the others: the hook of that name.
        handed_on: ``force`` of those effects alone that can part the load from the piston.
        rates: ``rates(command, t, y, w, z, p, plant, dz)`` writes the rates of the effects' own states.
    """

    received: Callable[..., float] | None
    jump: Callable[..., float] | None
    command: Callable[..., float]
    opening: Callable[..., float]
    supply_pressure: Callable[..., float]
    bulk_modulus: Callable[..., float]
    leakage: Callable[..., float]
    friction_level: Callable[..., float]
    force: Callable[..., float]
    piston_position: Callable[..., float]
    piston_velocity: Callable[..., float]
    handed_on: Callable[..., float]
    rates: Callable[..., None]


class Relations(NamedTuple):
    """The equations with the effects at their places, as compiled functions of ``t, y, z, c``.

    ``t`` is the time [s], ``y`` the plant's state, ``z`` the effects' own states, ``c`` the :class:`Coefficients`.

    Attributes:
        opened: spool displacement the orifice sees [m].
        volume: ``volume(opened, direction, t, y, z, c)``, the terms of (2): load flow (1) through an orifice open to a side
            (1 or -1), leakage beyond Ctc pL [m^3/s], bulk modulus and supply pressure [Pa].
        spool: rate of the spool (4) [m/s].
        extra: force of the effects beyond (3) [N].
        memory: ``memory(t, y, z, c, dz)`` writes the rates of the effects' own states.
    """

    opened: Callable[..., float]
    volume: Callable[..., tuple[float, float, float, float]]
    spool: Callable[..., float]
    extra: Callable[..., float]
    memory: Callable[..., None]


def relations(chains: Chains) -> Relations:
    """Build the equations with the effects of some chains."""
    command, opening, supply_pressure = chains.command, chains.opening, chains.supply_pressure
    bulk_modulus, leakage = chains.bulk_modulus, chains.leakage
    force, rates = chains.force, chains.rates

    @lean
    def opened(t: float, y: Array, z: Array, c: Coefficients) -> float:
        return opening(y[XV], t, y, c.inputs, z, c.effects, c.plant)

    @lean
    def volume(
        opened: float, direction: float, t: float, y: Array, z: Array, c: Coefficients
    ) -> tuple[float, float, float, float]:
        supply = supply_pressure(c.plant.supply_pressure, t, y, c.inputs, z, c.effects, c.plant)
        flow = load_flow(opened, direction, y[PL], supply, c.plant)  # (1)
        leak = leakage(0.0, t, y, c.inputs, z, c.effects, c.plant)
        modulus = bulk_modulus(c.plant.bulk_modulus, t, y, c.inputs, z, c.effects, c.plant)
        return flow, leak, modulus, supply

    @lean
    def spool(t: float, y: Array, z: Array, c: Coefficients) -> float:
        return spool_rate(y[XV], command(c.command, t, y, c.inputs, z, c.effects, c.plant), c.plant)  # (4)

    @lean
    def extra(t: float, y: Array, z: Array, c: Coefficients) -> float:
        return force(0.0, t, y, c.inputs, z, c.effects, c.plant)

    @lean
    def memory(t: float, y: Array, z: Array, c: Coefficients, dz: Array) -> None:
        rates(c.command, t, y, c.inputs, z, c.effects, c.plant, dz)

    return Relations(opened, volume, spool, extra, memory)


def balance_with(friction: Any, chains: Chains) -> Callable[..., tuple[float, float]]:
    """Build what acts on the mass.

    Args:
        friction: the friction model's file.
        chains: the effects.

    Returns:
        Compiled ``balance(extra, t, y, z, c)``: friction level with its effects and force on the mass without friction [N].
    """
    sliding_level, friction_level = friction.level, chains.friction_level

    @lean
    def balance(extra: float, t: float, y: Array, z: Array, c: Coefficients) -> tuple[float, float]:
        level = friction_level(sliding_level(y[V], c.friction), t, y, c.inputs, z, c.effects, c.plant)  # (7)
        return level, applied_force(y[X], y[V], y[PL], disturbance_force(t, c.inputs), extra, c.plant)

    return balance


def system(friction: Any, elements: int, chains: Chains) -> tuple[Callable[..., float], Callable[..., None]]:
    """Build the simulator's plant.

    Args:
        friction: the friction model's file.
        elements: number of its forces.
        chains: the effects.

    Returns:
        ``evaluate`` and ``switch`` as :mod:`ehls_ros.physics.integration` takes them.
    """
    end = FRICTION + elements
    friction_rates, friction_force = friction.rates, friction.force
    friction_event, friction_switch = friction.event, friction.switch
    opened, volume, spool, extra, memory = relations(chains)
    balance = balance_with(friction, chains)
    piston_velocity = chains.piston_velocity

    @lean
    def evaluate(t: float, y: Array, mode: Array, c: Coefficients, rate: Array) -> float:
        """Write dy/dt of (24) with the effects at their places.

        Returns:
            What is positive once the orifice has changed sides or a friction mode has to change.
        """
        plant, z = c.plant, y[end:]
        level, applied = balance(extra(t, y, z, c), t, y, z, c)
        resisting = friction_force(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)
        orifice = opened(t, y, z, c)
        flow, leak, modulus, _ = volume(orifice, mode[0], t, y, z, c)

        rate[X] = y[V]
        rate[V] = (applied - resisting) / plant.moving_mass  # (3)
        piston = piston_velocity(y[V], t, y, c.inputs, z, c.effects, plant)
        rate[PL] = load_pressure_rate(flow, piston, y[PL], leak, modulus, plant)  # (2)
        rate[XV] = spool(t, y, z, c)  # (4)
        friction_rates(y[V], level, y[FRICTION:end], mode[1:], c.friction, rate[FRICTION:end])  # (6), (8)
        memory(t, y, z, c, rate[end:])

        changed = friction_event(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)
        return max(-mode[0] * orifice, changed)

    @lean
    def switch(t: float, y: Array, mode: Array, c: Coefficients) -> None:
        """Change the modes whose event has come."""
        z = y[end:]
        if -mode[0] * opened(t, y, z, c) > 0.0:
            mode[0] = -mode[0]
        level, applied = balance(extra(t, y, z, c), t, y, z, c)
        y[V] = friction_switch(y[V], applied, level, y[FRICTION:end], mode[1:], c.friction)

    return evaluate, switch


JUMP_TOLERANCE = 1e-6
"""How near two jumps of the command are one, as a fraction of the step."""


def mover(run: Callable[..., int], chains: Chains, end: int) -> Callable[..., int]:
    """Build what moves a system on under inputs held, one command after the other as they arrive at the valve.

    Args:
        run: ``run(t, y, mode, c, command, step, steps, work) -> int`` goes on under one command.
        chains: the effects.
        end: where the effects' own states begin in the state.

    Returns:
        ``move(t, y, mode, c, step, steps, work)``, the sum of what ``run`` returns; ``c`` has the fields ``inputs``,
        ``effects`` and ``plant``. Where commands arrive late, it goes from jump to jump, in steps no longer than ``step``.
    """

    @lean
    def move(t: float, y: Array, mode: Array, c: Any, step: float, steps: int, work: Array) -> int:
        return run(t, y, mode, c, c.inputs[U], step, steps, work)

    if chains.received is None or chains.jump is None:
        return move
    received, jump = chains.received, chains.jump

    @lean
    def move_late(t: float, y: Array, mode: Array, c: Any, step: float, steps: int, work: Array) -> int:
        dense, now, whole = 0, t, steps * step
        last, tolerance = t + whole, JUMP_TOLERANCE * step
        while last - now > tolerance:
            until = min(jump(now + tolerance, c.inputs, c.effects), last)
            # Asked amid the piece, where no rounding can take it past a jump.
            command = received(c.inputs[U], 0.5 * (now + until), y, c.inputs, y[end:], c.effects, c.plant)
            length = until - now
            pieces = math.ceil(length / step - JUMP_TOLERANCE)
            # Without a jump the steps are to the bit those of an undelayed plant.
            dense += run(now, y, mode, c, command, step if length > whole - tolerance else length / pieces, pieces, work)
            now = until
        return dense

    return move_late
