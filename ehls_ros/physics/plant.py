"""The plant: equations (1)-(4) and a friction model, as one hybrid system for the integrator.

State ``y``: position and velocity of the moving mass (the piston's, unless an effect separates load and piston), load
pressure, spool displacement (x1..x4 of (24)), then the forces of the friction model, then the states of the cylinder, then
those of the effects. Where the pressures of both chambers are states of the cylinder, the load pressure is no state: every
evaluation of the equations writes it to ``y``, as the driving force over ``piston_area``.

Modes: those of the valve, of the cylinder, and of the friction model; each cylinder and valve starts with modes of 1.

:func:`relations` builds the equations with the effects' hooks; :func:`system` builds the simulator's plant from these,
a cylinder, a valve and a friction model. All functions are inlined, so unused effects cost nothing. The models that run along a
recording (:mod:`ehls_ros.physics.imposed_motion`) use the same relations.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, kernel, kernel_no_refcount
from ehls_ros.physics.equations import applied_force, load_flow, spool_rate
from ehls_ros.physics.parameters import Plant

X, V, PL, XV, FRICTION = 0, 1, 2, 3, 4
"""Indices of ``y``: position, velocity, load pressure, spool displacement; first friction force."""

U, FD, FD_RATE, XD, VD, TEMPERATURE, START, PERIOD, INPUTS = 0, 1, 2, 3, 4, 5, 6, 7, 8
"""Indices of the inputs ``w``: spool command [m], disturbance force [N] and its rate [N/s], displacement [m] and
velocity [m/s] of the position servo, oil temperature [K], time of the inputs [s], control period [s]; and their number.
If an effect needs past commands, they follow: ``w[INPUTS + i]`` was sent i + 1 cycles ago; it is zero before the first
command."""


@kernel
def chamber_pressures(y: Array, plant: Plant) -> tuple[float, float]:
    """Return the gauge pressures of both chambers, at least 0, for a matched, symmetric valve and the rig file's ps [Pa].

    Args:
        y: the plant's state.
        plant: the rig's coefficients.

    Returns:
        (ps + pL)/2 for the chamber that drives +x, (ps - pL)/2 for the other.
    """
    return max(0.5 * (plant.supply_pressure + y[PL]), 0.0), max(0.5 * (plant.supply_pressure - y[PL]), 0.0)


class Coefficients(NamedTuple):
    """Arguments of the equations besides time and state.

    Attributes:
        plant: the effective rig's coefficients.
        friction: the effective rig's friction parameters.
        inputs: ``w``.
        effects: ``p`` of the chains: the parameters of all effects in one array, or
            :class:`~ehls_ros.physics.composition.Switched`.
        command: spool command that has arrived at the valve [m].
        cylinder: ``Parameters`` of the cylinder; () if it has none.
        valve: ``Parameters`` of the valve; () if it has none.
    """

    plant: Plant
    friction: Any
    inputs: Array
    effects: Any
    command: float
    cylinder: Any
    valve: Any


@kernel
def hold(w: Array, start: float, command: float, force: float, force_rate: float, displacement: float, velocity: float) -> None:
    """Set the inputs of a new cycle; past commands shift back by one.

    Args:
        w: inputs, updated in place.
        start: time at which the cycle begins [s].
        command: spool command, held over the cycle [m].
        force: disturbance force at the start [N].
        force_rate: rate of the disturbance force [N/s].
        displacement: displacement of the position servo at the start [m].
        velocity: velocity of the position servo [m/s].
    """
    for i in range(w.size - 1, INPUTS, -1):
        w[i] = w[i - 1]
    if w.size > INPUTS:
        w[INPUTS] = w[U]
    w[U], w[FD], w[FD_RATE], w[XD], w[VD], w[START] = command, force, force_rate, displacement, velocity, start


@kernel
def follow_servo(w: Array, t: float, displacement: float, velocity: float) -> None:
    """Set the motion of a simulated position servo to its tangent at t, in place of the input.

    Args:
        w: inputs, updated in place.
        t: time [s].
        displacement: displacement of the servo [m].
        velocity: velocity of the servo [m/s].
    """
    w[XD], w[VD] = displacement - velocity * (t - w[START]), velocity


@kernel
def disturbance_force(t: float, w: Array) -> float:
    """Return fd(t) [N], linear within a cycle."""
    return w[FD] + w[FD_RATE] * (t - w[START])


@kernel
def servo_displacement(t: float, w: Array) -> float:
    """Return the displacement of the position servo at t [m], linear within a cycle."""
    return w[XD] + w[VD] * (t - w[START])


@kernel
def servo_velocity(w: Array) -> float:
    """Return the position servo's velocity [m/s]."""
    return w[VD]


class Chains(NamedTuple):
    """The hooks of several effects, chained by name: compiled ``hook(value, t, y, w, z, p, plant) -> value``.

    The arguments are those of :mod:`ehls_ros.physics.effects.base`, except that ``z`` holds the states and ``p`` the
    parameters of all chained effects. :mod:`ehls_ros.physics.composition` generates the chains. Those without an entry
    below are the hooks of the same name.

    Attributes:
        received: the hook of that name; None if no effect delays the command.
        jump: ``jump(t, w, p)``, the time of the next jump of ``received`` after t [s]; None if no effect delays the command.
        joint_force: ``force`` of only those effects that can separate the load from the piston.
        coupling_force: ``force`` of only those effects that couple the loader to the position servo.
        piston_leakage: the hook on the chambers, which has a pressure as its second argument.
        rates: ``rates(command, t, y, w, z, p, plant, dz)`` writes the rates of the effects' states.
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
    position_reading: Callable[..., float]
    pressure_reading: Callable[..., float]
    force_reading: Callable[..., float]
    joint_force: Callable[..., float]
    coupling_force: Callable[..., float]
    piston_leakage: Callable[..., float]
    rates: Callable[..., None]


class Relations(NamedTuple):
    """The equations with the effects applied, as compiled functions of ``t, y, z, c``.

    ``t`` is the time [s], ``y`` the plant's state, ``z`` the effects' states, ``c`` the :class:`Coefficients`.

    Attributes:
        effective_opening: spool displacement effective at the orifice [m].
        volume: ``volume(opening, direction, t, y, z, c)``, the terms of (2): load flow (1) through an orifice with this sign
            of the opening (1 or -1), leakage beyond Ctc pL [m^3/s], bulk modulus and supply pressure [Pa].
        spool: rate of the spool (4) [m/s].
        extra: force of the effects beyond (3) [N].
        effect_rates: ``effect_rates(t, y, z, c, dz)`` writes the rates of the effects' states.
    """

    effective_opening: Callable[..., float]
    volume: Callable[..., tuple[float, float, float, float]]
    spool: Callable[..., float]
    extra: Callable[..., float]
    effect_rates: Callable[..., None]


class Oil(NamedTuple):
    """Volume balance of a cylinder with its valve, as compiled functions of ``t, y, z, c`` as in :class:`Relations`.

    Attributes:
        evaluate: ``evaluate(t, y, z, mode, c, rate)`` writes the rates of the load pressure or of the chambers, and returns
            the event function of valve and cylinder; ``mode`` begins with their modes.
        switch: ``switch(t, y, z, mode, c)`` changes these modes at the event.
        sense: ``sense(t, y, z, c, truth)`` writes the true values of force and pressures.
    """

    evaluate: Callable[..., float]
    switch: Callable[..., None]
    sense: Callable[..., None]


def relations(chains: Chains, flow: Callable[..., float] = load_flow) -> Relations:
    """Build the equations with the effects of ``chains``, and the load flow of a valve."""
    command, opening, supply_pressure = chains.command, chains.opening, chains.supply_pressure
    bulk_modulus, leakage = chains.bulk_modulus, chains.leakage
    force, rates = chains.force, chains.rates

    @kernel_no_refcount
    def effective_opening(t: float, y: Array, z: Array, c: Coefficients) -> float:
        return opening(y[XV], t, y, c.inputs, z, c.effects, c.plant)

    @kernel_no_refcount
    def volume(
        orifice: float, direction: float, t: float, y: Array, z: Array, c: Coefficients
    ) -> tuple[float, float, float, float]:
        supply = supply_pressure(c.plant.supply_pressure, t, y, c.inputs, z, c.effects, c.plant)
        through = flow(orifice, direction, y[PL], supply, c.plant)  # (1)
        leak = leakage(0.0, t, y, c.inputs, z, c.effects, c.plant)
        modulus = bulk_modulus(c.plant.bulk_modulus, t, y, c.inputs, z, c.effects, c.plant)
        return through, leak, modulus, supply

    @kernel_no_refcount
    def spool(t: float, y: Array, z: Array, c: Coefficients) -> float:
        return spool_rate(y[XV], command(c.command, t, y, c.inputs, z, c.effects, c.plant), c.plant)  # (4)

    @kernel_no_refcount
    def extra(t: float, y: Array, z: Array, c: Coefficients) -> float:
        return force(0.0, t, y, c.inputs, z, c.effects, c.plant)

    @kernel_no_refcount
    def effect_rates(t: float, y: Array, z: Array, c: Coefficients, dz: Array) -> None:
        rates(c.command, t, y, c.inputs, z, c.effects, c.plant, dz)

    return Relations(effective_opening, volume, spool, extra, effect_rates)


def balance_with(friction: Any, chains: Chains) -> Callable[..., tuple[float, float]]:
    """Build the terms of the force balance (3).

    Args:
        friction: module of the friction model.
        chains: hooks of the effects.

    Returns:
        Compiled ``balance(extra, t, y, z, c)``: Stribeck level with the effects on it, and force on the moving mass without
        friction [N].
    """
    sliding_level, friction_level = friction.level, chains.friction_level

    @kernel_no_refcount
    def balance(extra: float, t: float, y: Array, z: Array, c: Coefficients) -> tuple[float, float]:
        level = friction_level(sliding_level(y[V], c.friction), t, y, c.inputs, z, c.effects, c.plant)  # (7)
        return level, applied_force(y[X], y[V], y[PL], disturbance_force(t, c.inputs), extra, c.plant)

    return balance


def break_away_with(friction: Any) -> Callable[[float, float, Any], float]:
    """Build the break-away force beside a Stribeck level with effects on it.

    Args:
        friction: module of the friction model.

    Returns:
        Compiled ``break_away(level, v, p)``: the level at rest [N] in proportion to that at a velocity ``v``.
    """
    sliding_level = friction.level

    @kernel_no_refcount
    def break_away(level: float, v: float, p: Any) -> float:
        return level * (sliding_level(0.0, p) / sliding_level(v, p))

    return break_away


def motion(friction: Any, elements: int, chains: Chains) -> tuple[Callable[..., float], Callable[..., None]]:
    """Build the equation of motion of the moving mass, with friction.

    Args:
        friction: module of the friction model.
        elements: number of the model's forces.
        chains: hooks of the effects.

    Returns:
        Compiled ``evaluate(extra, t, y, z, mode, c, rate)`` and ``switch(extra, t, y, z, mode, c)``. The first writes the rates
        of position, velocity and friction forces, and returns the friction model's event function. The second changes the
        modes and the velocity at its event. ``extra`` is the force beyond (3) [N], ``mode`` the friction model's modes.
    """
    end = FRICTION + elements
    friction_rates, friction_force = friction.rates, friction.force
    friction_event, friction_switch = friction.event, friction.switch
    balance = balance_with(friction, chains)

    @kernel_no_refcount
    def evaluate(extra: float, t: float, y: Array, z: Array, mode: Array, c: Coefficients, rate: Array) -> float:
        level, applied = balance(extra, t, y, z, c)
        resisting = friction_force(y[V], applied, level, y[FRICTION:end], mode, c.friction)
        rate[X] = y[V]
        rate[V] = (applied - resisting) / c.plant.moving_mass  # (3)
        friction_rates(y[V], level, y[FRICTION:end], mode, c.friction, rate[FRICTION:end])  # (6), (8)
        return friction_event(y[V], applied, level, y[FRICTION:end], mode, c.friction)

    @kernel_no_refcount
    def switch(extra: float, t: float, y: Array, z: Array, mode: Array, c: Coefficients) -> None:
        level, applied = balance(extra, t, y, z, c)
        y[V] = friction_switch(y[V], applied, level, y[FRICTION:end], mode, c.friction)

    return evaluate, switch


def first_effect(cylinder: Any, elements: int) -> int:
    """Return the index of the effects' first state in ``y``.

    Args:
        cylinder: module of the cylinder.
        elements: number of the friction model's forces.
    """
    return FRICTION + elements + int(cylinder.STATES)


def system(
    cylinder: Any, valve: Any, friction: Any, elements: int, chains: Chains
) -> tuple[Callable[..., float], Callable[..., None]]:
    """Build the simulator's plant.

    Args:
        cylinder: module of the cylinder.
        valve: module of the valve.
        friction: module of the friction model.
        elements: number of the model's forces.
        chains: hooks of the effects.

    Returns:
        ``evaluate`` and ``switch`` for :mod:`ehls_ros.physics.integration`.
    """
    end, oil_modes = first_effect(cylinder, elements), valve.MODES + cylinder.MODES
    equations = relations(chains)
    spool, extra, effect_rates = equations.spool, equations.extra, equations.effect_rates
    move, reverse = motion(friction, elements, chains)
    balance_oil, switch_oil, _ = cylinder.build(valve, chains, FRICTION + elements)

    @kernel_no_refcount
    def evaluate(t: float, y: Array, mode: Array, c: Coefficients, rate: Array) -> float:
        """Write dy/dt of (24) with the effects applied.

        Returns:
            Event function: positive once a mode of valve, cylinder or friction must change.
        """
        z = y[end:]
        passed = balance_oil(t, y, z, mode, c, rate)  # (1), (2)
        rate[XV] = spool(t, y, z, c)  # (4)
        changed = move(extra(t, y, z, c), t, y, z, mode[oil_modes:], c, rate)  # (3), (6), (8)
        effect_rates(t, y, z, c, rate[end:])
        return max(passed, changed)

    @kernel_no_refcount
    def switch(t: float, y: Array, mode: Array, c: Coefficients) -> None:
        """Change the modes at an event."""
        z = y[end:]
        switch_oil(t, y, z, mode, c)
        reverse(extra(t, y, z, c), t, y, z, mode[oil_modes:], c)

    return evaluate, switch


JUMP_TOLERANCE = 1e-6
"""Distance below which two jumps of the command count as one, as a fraction of the step."""


def cycle_stepper(run: Callable[..., int], chains: Chains, end: int) -> Callable[..., int]:
    """Build the function that integrates over one cycle, during which commands may arrive at the valve.

    Args:
        run: ``run(t, y, mode, c, command, step, steps, work) -> int`` integrates with a constant command.
        chains: hooks of the effects.
        end: index of the effects' first state in ``y``.

    Returns:
        ``step_cycle(t, y, mode, c, step, steps, work)``, which returns the sum of the results of ``run``; ``c`` has the fields
        ``inputs``, ``effects`` and ``plant``. If commands are delayed, it integrates from jump to jump, in steps of at most
        ``step``.
    """

    @kernel_no_refcount
    def step_cycle(t: float, y: Array, mode: Array, c: Any, step: float, steps: int, work: Array) -> int:
        return run(t, y, mode, c, c.inputs[U], step, steps, work)

    if chains.received is None or chains.jump is None:
        return step_cycle
    received, jump = chains.received, chains.jump

    @kernel_no_refcount
    def step_delayed(t: float, y: Array, mode: Array, c: Any, step: float, steps: int, work: Array) -> int:
        dense, now, whole = 0, t, steps * step
        last, tolerance = t + whole, JUMP_TOLERANCE * step
        while last - now > tolerance:
            until = min(jump(now + tolerance, c.inputs, c.effects), last)
            # Evaluated mid-interval, away from rounding errors at the jumps.
            command = received(c.inputs[U], 0.5 * (now + until), y, c.inputs, y[end:], c.effects, c.plant)
            length = until - now
            pieces = math.ceil(length / step - JUMP_TOLERANCE)
            # Without a jump, the steps are bitwise those of a plant without delay.
            dense += run(now, y, mode, c, command, step if length > whole - tolerance else length / pieces, pieces, work)
            now = until
        return dense

    return step_delayed
