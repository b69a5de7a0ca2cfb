"""Rigs that neither the package nor its truth generator knows, drawn from a seed, and their recordings.

Nothing here is imported from either. The cylinder has two chambers whose volumes change with the stroke, the valve has four
edges with lap and a second-order spool, the supply droops, the oil contains air, and the friction is one of three laws. A
discrete PI controller drives the rig through steps, sweeps and sums of sines.

Equations, with x the piston position and each chamber's pressure above the atmosphere::

    dpa/dt = β(pa)/Va (Q_PA - Q_AT - A v - Q_leak),   Va = Vd + A (h/2 + x)
    dpb/dt = β(pb)/Vb (Q_PB - Q_BT + A v + Q_leak),   Vb = Vd + A (h/2 - x)
    m dv/dt = A (pa - pb) - F_friction - F_load - m g
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rng = np.random.Generator
Compiled = TypeVar("Compiled", bound=Callable[..., Any])

LUGRE, MAXWELL_SLIP, HYSTERESIS = 0, 1, 2
LAWS = ("LuGre", "generalised Maxwell slip", "presliding hysteresis")
"""Friction laws, in the order of their numbers."""

ELEMENTS = 3
X, V, PA, PB, SPOOL, SPOOL_RATE, PS, Z, STATES = 0, 1, 2, 3, 4, 5, 6, 7, 7 + ELEMENTS
"""Places in the state; the friction elements follow from Z on."""

READ_PA, READ_PB, READ_PS, READ_X, READ_CELL, READ_SPOOL, READINGS = 0, 1, 2, 3, 4, 5, 6
"""Sensors."""

TRAVEL, FULL = 1e-3, 10.0
"""Spool displacement [m] at the largest command [V]."""

ATMOSPHERE, TRANSITION, CAVITATION = 1.013e5, 2e4, 1e4
"""Atmospheric pressure; pressure drop below which an edge's flow is laminar; lowest gauge pressure [Pa]."""

STEP = 1.25e-5
"""Longest step of the integration [s]."""

DURATION = 30.0
"""Duration of a recording [s]."""

AMOUNTS = {
    "leakage": (0.003, 0.08),
    "bulk_modulus": (0.05, 0.6),
    "coulomb": (0.05, 0.7),
    "viscous": (0.08, 0.7),
    "mass": (0.02, 0.4),
    "flow_gain": (0.01, 0.12),
    "valve_null": (0.0008, 0.02),
    "supply_pressure": (0.02, 0.15),
    "pressure_gain": (0.005, 0.05),
    "pressure_bias": (0.001, 0.015),
    "spring": (0.02, 0.3),
}
"""Least and largest amount of each hidden change, relative to its coefficient, the rated flow, the travel or the supply."""

KINDS = tuple(AMOUNTS)
"""Hidden changes."""

HEALTHY_EVERY = 4
"""One stranger in so many has no hidden change."""


class Rig(NamedTuple):
    """True values of a rig in SI units; commands in volts."""

    area: float
    stroke: float
    dead_volume: float
    mass: float
    gravity: float
    # oil
    modulus: float
    stiffening: float
    air: float
    modulus_factor: float
    # supply
    source_pressure: float
    source_resistance: float
    source_time: float
    tank_pressure: float
    # valve
    edge_gain: float
    overlap: float
    rounding: float
    natural_frequency: float
    damping_ratio: float
    null: float
    play: float
    delay_cycles: int
    # leakage past the piston
    laminar: float
    turbulent: float
    # friction
    law: int
    coulomb: float
    static: float
    stribeck_velocity: float
    stribeck_exponent: float
    viscous: float
    presliding: float
    micro_damping: float
    asymmetry: float
    # load: a spring to the ground, or a moving counterpart on a spring
    counterpart: bool
    spring: float
    spring_zero: float
    spring_damping: float
    # sensors
    pressure_gain: float
    pressure_bias: float


class Sensors(NamedTuple):
    """Noise, resolution and offset of each sensor, shape (READINGS,), and whether spool and supply are recorded."""

    noise: Array
    resolution: Array
    offset: Array
    spool: bool
    supply: bool


class Control(NamedTuple):
    """Discrete controller: PI on position or force, with a feed-forward of the reference's rate."""

    rate: float
    every: int
    of_force: bool
    proportional: float
    integral: float
    forward: float


class Stranger(NamedTuple):
    """A rig, its hidden change and the information that its engineer has.

    Attributes:
        seed, number: of the draw.
        rig: the healthy rig.
        changed: the rig with its hidden change; the same if there is none.
        kind: one of KINDS; empty if there is no change.
        size: the change: relative for factors, otherwise in SI units.
        answers: answers to the questions of a new rig, as data sheets give them.
        sensors, control: the measurement and the controller.
        german: whether the headers are German and the decimals commas.
    """

    seed: int
    number: int
    rig: Rig
    changed: Rig
    kind: str
    size: float
    answers: Mapping[str, float | str]
    sensors: Sensors
    control: Control
    german: bool


class Samples(NamedTuple):
    """A recording as its sensors show it: time [s], command [V] and readings in SI units, the spool in volts."""

    time: Array
    command: Array
    readings: Array
    inside: float
    saturated: float


def compiled(function: Compiled) -> Compiled:
    """Compile a function, cached on disk."""
    return cast(Compiled, numba.njit(cache=True)(function))


# --- physics --------------------------------------------------------------------------------------


@compiled
def _edge(rig: Rig, opening: float, drop: float) -> float:
    """Return the flow through one metering edge [m^3/s]."""
    area = 0.5 * (opening + math.sqrt(opening * opening + rig.rounding * rig.rounding))
    return rig.edge_gain * area * drop / math.sqrt(math.hypot(drop, TRANSITION))


@compiled
def _modulus(rig: Rig, gauge: float) -> float:
    """Return the bulk modulus of oil with air at a gauge pressure [Pa]."""
    absolute = max(gauge, 0.0) + ATMOSPHERE
    air = rig.air * math.pow(ATMOSPHERE / absolute, 1.0 / 1.4) / (1.4 * absolute)
    return rig.modulus_factor / (1.0 / (rig.modulus + rig.stiffening * absolute) + air)


@compiled
def _level(rig: Rig, v: float) -> float:
    """Return the friction of steady sliding without its viscous part [N]."""
    curve = math.exp(-math.pow(abs(v) / rig.stribeck_velocity, rig.stribeck_exponent))
    side = 1.0 + rig.asymmetry * (1.0 if v > 0.0 else -1.0)
    return (rig.coulomb + (rig.static - rig.coulomb) * curve) * side


@compiled
def _weight(i: int) -> float:
    """Return the share of a friction element in the whole."""
    return (0.5, 0.3, 0.2)[i]


@compiled
def _friction(rig: Rig, y: Array, dy: Array, slips: NDArray[np.bool_]) -> float:
    """Return the friction force [N] and write the rates of its states."""
    v, level = y[V], _level(rig, y[V])
    stiffness = rig.static / rig.presliding
    if rig.law == LUGRE:
        dy[Z] = v - stiffness * abs(v) / level * y[Z]
        dy[Z + 1] = dy[Z + 2] = 0.0
        return float(stiffness * y[Z] + rig.micro_damping * dy[Z] + rig.viscous * v)
    if rig.law == MAXWELL_SLIP:
        force = rig.viscous * v
        for i in range(ELEMENTS):
            if slips[i]:
                attraction = rig.coulomb / 0.05
                dy[Z + i] = attraction * (math.copysign(_weight(i), v) - y[Z + i] / level)
            else:
                dy[Z + i] = stiffness * (0.7, 0.2, 0.1)[i] * v
            force += y[Z + i]
        return float(force)
    side = 1.0 if v >= 0.0 else -1.0
    left = 1.0 - y[Z] * side / level
    dy[Z] = stiffness * v * math.copysign(math.pow(abs(left), 1.5), left)
    dy[Z + 1] = dy[Z + 2] = 0.0
    return float(y[Z] + rig.viscous * v)


@compiled
def _slipping(rig: Rig, y: Array, before: float, slips: NDArray[np.bool_]) -> None:
    """Update at the end of a step which friction elements slip."""
    for i in range(ELEMENTS):
        if slips[i]:
            slips[i] = y[V] * before > 0.0
        else:
            slips[i] = abs(y[Z + i]) >= _weight(i) * _level(rig, y[V]) and y[V] * y[Z + i] > 0.0


@compiled
def _counterpart(t: float, sines: Array) -> tuple[float, float]:
    """Return position and velocity of the counterpart; ``sines`` has amplitude, angular frequency and phase in each row."""
    x = v = 0.0
    for i in range(sines.shape[0]):
        x += sines[i, 0] * math.sin(sines[i, 1] * t + sines[i, 2])
        v += sines[i, 0] * sines[i, 1] * math.cos(sines[i, 1] * t + sines[i, 2])
    return x, v


@compiled
def _load(rig: Rig, t: float, y: Array, sines: Array) -> float:
    """Return the load's force against the piston [N]."""
    other, moving = _counterpart(t, sines) if rig.counterpart else (rig.spring_zero, 0.0)
    return float(rig.spring * (y[X] - other) + rig.spring_damping * (y[V] - moving))


@compiled
def _rates(rig: Rig, t: float, y: Array, target: float, sines: Array, slips: NDArray[np.bool_], dy: Array) -> None:
    xs, v, pa, pb, ps, tank = y[SPOOL], y[V], y[PA], y[PB], y[PS], rig.tank_pressure
    into_a = _edge(rig, xs - rig.overlap, ps - pa)
    from_a = _edge(rig, -xs - rig.overlap, pa - tank)
    into_b = _edge(rig, -xs - rig.overlap, ps - pb)
    from_b = _edge(rig, xs - rig.overlap, pb - tank)
    drop = pa - pb
    leak = rig.laminar * drop + rig.turbulent * drop / math.sqrt(math.hypot(drop, TRANSITION))
    middle, swept = rig.dead_volume + 0.5 * rig.area * rig.stroke, rig.area * y[X]
    dy[X] = v
    dy[V] = (rig.area * drop - _friction(rig, y, dy, slips) - _load(rig, t, y, sines)) / rig.mass - rig.gravity
    dy[PA] = _modulus(rig, pa) / (middle + swept) * (into_a - from_a - rig.area * v - leak)
    dy[PB] = _modulus(rig, pb) / (middle - swept) * (into_b - from_b + rig.area * v + leak)
    if pa < CAVITATION:
        dy[PA] = max(dy[PA], 0.0)
    if pb < CAVITATION:
        dy[PB] = max(dy[PB], 0.0)
    dy[SPOOL] = y[SPOOL_RATE]
    dy[SPOOL_RATE] = rig.natural_frequency**2 * (target - xs) - 2.0 * rig.damping_ratio * rig.natural_frequency * y[SPOOL_RATE]
    drawn = rig.source_pressure - rig.source_resistance * (into_a + into_b)
    dy[PS] = (drawn - ps) / rig.source_time


@compiled
def _ahead(y: Array, h: float, k: Array, at: Array) -> None:
    """Write the state after ``h`` at constant rates to ``at``."""
    for i in range(STATES):
        at[i] = y[i] + h * k[i]


@compiled
def _run(
    rig: Rig, control: Control, reference: Array, rate_of_reference: Array, sines: Array, noise: Array, sensors: Sensors,
    steps: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Return command [V] and readings at each cycle of the controller; Runge-Kutta of fourth order between cycles."""
    cycles = reference.size
    h = 1.0 / (control.rate * steps)
    y, slips = np.zeros(STATES), np.zeros(ELEMENTS, dtype=np.bool_)
    at, k1, k2, k3, k4 = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    y[X] = _counterpart(0.0, sines)[0] if rig.counterpart else 0.0
    y[PS] = rig.source_pressure
    y[PA] = y[PB] = 0.5 * rig.source_pressure
    commands, readings = np.zeros(cycles), np.zeros((cycles, READINGS))
    summed = played = waiting = 0.0
    for k in range(cycles):
        begin = k / control.rate
        true = readings[k]
        true[READ_PA] = rig.pressure_gain * y[PA] + rig.pressure_bias
        true[READ_PB] = rig.pressure_gain * y[PB]
        true[READ_PS], true[READ_X], true[READ_SPOOL] = y[PS], y[X], y[SPOOL] / TRAVEL * FULL
        true[READ_CELL] = _load(rig, begin, y, sines) if rig.counterpart else 0.0
        for j in range(READINGS):
            shown = true[j] + sensors.offset[j] + noise[k, j]
            true[j] = round(shown / sensors.resolution[j]) * sensors.resolution[j]
        force = true[READ_CELL] if rig.counterpart else rig.area * (true[READ_PA] - true[READ_PB])
        error = reference[k] - (force if control.of_force else true[READ_X])
        whole = control.proportional * error + summed + control.forward * rate_of_reference[k]
        command = min(max(whole, -FULL), FULL)
        if command == whole:
            summed += control.integral * error / control.rate
        command = round(command / 3e-4) * 3e-4
        commands[k] = command
        arriving = waiting if rig.delay_cycles else command
        waiting = command
        played = min(max(played, arriving - rig.play), arriving + rig.play)
        target = min(max((played + rig.null) / FULL, -1.0), 1.0) * TRAVEL
        for step in range(steps):
            t, before = begin + step * h, y[V]
            _rates(rig, t, y, target, sines, slips, k1)
            _ahead(y, 0.5 * h, k1, at)
            _rates(rig, t + 0.5 * h, at, target, sines, slips, k2)
            _ahead(y, 0.5 * h, k2, at)
            _rates(rig, t + 0.5 * h, at, target, sines, slips, k3)
            _ahead(y, h, k3, at)
            _rates(rig, t + h, at, target, sines, slips, k4)
            for i in range(STATES):
                y[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
            _slipping(rig, y, before, slips)
    return commands, readings


# --- recordings -----------------------------------------------------------------------------------


def _sines(rng: Rng, lowest: float, highest: float, count: int, speed: float) -> Array:
    """Return amplitude, angular frequency and phase of sines whose velocities are alike, ``speed`` rms together."""
    omega = 2.0 * math.pi * np.exp(rng.uniform(math.log(lowest), math.log(highest), count))
    amplitude = speed * math.sqrt(2.0 / count) / omega
    return np.column_stack([amplitude, omega, rng.uniform(0.0, 2.0 * math.pi, count)])


def _reference(rng: Rng, time: Array, span: float, speed: float, fastest: float) -> Array:
    """Return a reference of an amplitude of at most ``span`` and an rms rate of about ``speed``: three parts."""
    parts = rng.permutation(3)
    out = np.zeros_like(time)
    ends = np.linspace(0.0, time[-1], 4)
    for place, part in enumerate(parts):
        here = (time >= ends[place]) & (time <= ends[place + 1])
        t, length = time[here] - ends[place], ends[place + 1] - ends[place]
        if part == 0:
            a, w, p = _sines(rng, 0.15, fastest, 8, speed).T
            own = np.sin(np.outer(t, w) + p) @ a
        elif part == 1:
            own, at, level = np.zeros_like(t), 0.0, 0.0
            while at < length:
                new, slope = rng.uniform(-0.8, 0.8) * span, rng.uniform(1.0, 3.0) * speed
                ramp = max(1.5 * abs(new - level) / slope, 0.05)
                s = np.clip((t - at) / ramp, 0.0, 1.0)
                own = np.where(t >= at, level + (new - level) * s * s * (3.0 - 2.0 * s), own)
                at, level = at + ramp + rng.uniform(0.2, 0.8), new
        else:
            low, high = 0.2, fastest
            growth = math.log(high / low) / length
            phase = 2.0 * math.pi * low * (np.exp(growth * t) - 1.0) / growth
            amplitude = np.minimum(math.sqrt(2.0) * speed / (2.0 * math.pi * low * np.exp(growth * t)), 0.7 * span)
            own = amplitude * np.sin(phase)
        edge = np.clip(np.minimum(t, length - t) / 0.3, 0.0, 1.0)
        out[here] = own * edge * edge * (3.0 - 2.0 * edge)
    return out * min(1.0, span / max(float(np.max(np.abs(out))), 1e-12))


def simulate(stranger: Stranger, rig: Rig, turn: int, duration: float = DURATION, step: float = STEP) -> Samples:
    """Record a rig of a stranger.

    Args:
        stranger: its sensors and controller.
        rig: the healthy or the changed rig.
        turn: number of the recording, from which its reference and noise follow.
        duration: of the recording [s].
        step: longest step of the integration [s].
    """
    control, sensors, healthy = stranger.control, stranger.sensors, stranger.rig
    rng = np.random.default_rng([stranger.seed, stranger.number, 100 + turn])
    time = np.arange(round(duration * control.rate)) / control.rate
    fastest = float(rng.uniform(3.0, 7.0))
    speed = float(rng.uniform(0.12, 0.25)) * top_speed(healthy)
    span = float(rng.uniform(0.25, 0.38)) * healthy.stroke
    sines = _sines(rng, 0.1, 1.5, 5, 0.5 * speed) if healthy.counterpart else np.zeros((1, 3))
    sines[:, 0] *= min(1.0, 0.2 * healthy.stroke / max(float(np.sum(sines[:, 0])), 1e-12))
    if control.of_force:
        largest = 0.4 * healthy.area * healthy.source_pressure
        span = min(healthy.spring * span, largest)
        reference = _reference(rng, time, span, healthy.spring * speed * (0.5 if healthy.counterpart else 0.8), 0.5 * fastest)
    else:
        softest = 0.4 * healthy.area * healthy.source_pressure / max(healthy.spring, 1.0)
        reference = _reference(rng, time, min(span, softest), speed, fastest)
        if healthy.counterpart:
            # The piston follows the counterpart, and strains the spring between them.
            reference += np.sin(np.outer(time, sines[:, 1]) + sines[:, 2]) @ sines[:, 0]
    noise = rng.normal(size=(time.size, READINGS)) * sensors.noise
    steps = math.ceil(1.0 / (control.rate * step))
    rate = np.gradient(reference, time)
    command, readings = _run(rig, control, reference, rate, sines, noise, sensors, steps)
    rows = slice(None, None, control.every)
    travel = float(np.max(np.abs(readings[:, READ_X]))) / (0.5 * healthy.stroke)
    saturated = float(np.mean(np.abs(command) > 0.98 * FULL))
    return Samples(time[rows], command[rows], readings[rows], travel, saturated)


def top_speed(rig: Rig) -> float:
    """Return the velocity of the unloaded piston at full command [m/s]."""
    return rig.edge_gain * TRAVEL * math.sqrt(0.5 * rig.source_pressure) / rig.area


# --- draws ----------------------------------------------------------------------------------------

BORES = (25, 32, 40, 50, 63, 80, 100, 125, 140, 160)
RODS = {25: 18, 32: 22, 40: 28, 50: 36, 63: 45, 80: 56, 100: 70, 125: 90, 140: 100, 160: 110}
STROKES = (80, 100, 125, 160, 200, 250, 300, 400, 500)
FLOWS = (2, 3, 4, 5, 7.5, 10, 12, 16, 19, 24, 30, 38, 40, 60, 63, 80, 100, 120, 160, 200, 250, 350, 500, 750)
RATES = (500.0, 1000.0, 1000.0, 2000.0, 4000.0)
"""Series of data sheets: mm, l/min; rates of controllers [1/s]."""


def draw(seed: int, number: int) -> Stranger:
    """Draw a stranger; it depends on the seed and its number only. Its control loop is tuned until it runs."""
    rng = np.random.default_rng([seed, number])
    kind = kind_of(seed, number)
    first = _drawn(rng, seed, number, kind)
    for _ in range(8):
        tried = [simulate(first, rig, turn, 10.0) for turn, rig in ((0, first.rig), (2, first.changed))]
        if all(s.inside < 0.93 and s.saturated < 0.02 and np.all(np.isfinite(s.readings)) for s in tried):
            return first
        c = first.control
        first = first._replace(control=c._replace(proportional=0.6 * c.proportional, integral=0.6 * c.integral))
    raise RuntimeError(f"stranger {seed}/{number} cannot be controlled")


def kind_of(seed: int, number: int) -> str:
    """Return the hidden change of a stranger: all kinds equally often, in an order given by the seed; empty for none."""
    if number % HEALTHY_EVERY == HEALTHY_EVERY - 1:
        return ""
    place = number - number // HEALTHY_EVERY
    turn, index = divmod(place, len(KINDS))
    return KINDS[int(np.random.default_rng([seed, turn, 36]).permutation(len(KINDS))[index])]


def _near(rng: Rng, series: Sequence[float], wanted: float) -> float:
    return min(series, key=lambda value: abs(math.log(value / wanted)))


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _between(rng: Rng, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _drawn(rng: Rng, seed: int, number: int, kind: str) -> Stranger:
    pressure = float(rng.choice([100, 140, 160, 210, 210, 280]))
    largest = _between(rng, 2e3, 2.5e5)
    bore = float(_near(rng, BORES, 1e3 * math.sqrt(largest / (pressure * 1e5) / (0.25 * math.pi * 0.5))))
    rod = float(RODS[int(bore)])
    area = 0.25e-6 * math.pi * (bore**2 - rod**2)
    stroke = float(rng.choice(STROKES))
    flow = float(_near(rng, FLOWS, 6e4 * area * _between(rng, 0.25, 0.9) / math.sqrt(pressure / 70.0)))
    mass = _between(rng, 0.4, 1.2) * math.sqrt(area * pressure * 1e5)
    swept = area * stroke * 1e-3
    force = area * pressure * 1e5
    coulomb = _between(rng, 0.008, 0.05) * force
    law = int(rng.integers(3))
    counterpart = bool(rng.random() < 0.45)
    if kind == "spring":
        counterpart = False
    if kind == "pressure_gain":
        counterpart = True
    if counterpart:
        spring = 0.4 * force / _between(rng, 4e-3, 1.2e-2)
    else:
        spring = 0.0 if kind != "spring" and rng.random() < 0.2 else 0.4 * force / (_between(rng, 0.3, 0.6) * 1e-3 * stroke)
    speed = flow / 6e4 * math.sqrt(pressure / 70.0) / area
    source = pressure * 1e5 * float(rng.uniform(0.97, 1.02))
    gravity = float(rng.choice([0.0, 0.0, 0.0, 9.81, -9.81]))
    rig = Rig(
        area=area, stroke=1e-3 * stroke, dead_volume=swept * _between(rng, 0.08, 0.4), mass=mass, gravity=gravity,
        modulus=_between(rng, 0.8e9, 1.5e9), stiffening=float(rng.uniform(2.0, 10.0)), air=_between(rng, 5e-4, 8e-3),
        modulus_factor=1.0,
        source_pressure=source, source_resistance=float(rng.uniform(0.02, 0.12)) * source / (flow / 6e4),
        source_time=_between(rng, 0.01, 0.08), tank_pressure=float(rng.uniform(1e5, 5e5)),
        edge_gain=float(rng.uniform(0.9, 1.1)) * flow / 6e4 / (TRAVEL * math.sqrt(35e5)),
        overlap=float(rng.choice([0.0, -1.0, 1.0])) * _between(rng, 0.002, 0.015) * TRAVEL,
        rounding=_between(rng, 0.003, 0.012) * TRAVEL,
        natural_frequency=2.0 * math.pi * _between(rng, 40.0, 140.0), damping_ratio=float(rng.uniform(0.6, 1.0)),
        null=float(rng.uniform(-0.15, 0.15)), play=_between(rng, 0.003, 0.02), delay_cycles=int(rng.random() < 0.4),
        laminar=_between(rng, 0.002, 0.02) * flow / 6e4 / source,
        turbulent=float(rng.choice([0.0, 0.5])) * 0.005 * flow / 6e4 / math.sqrt(source),
        law=law, coulomb=coulomb, static=coulomb * float(rng.uniform(1.05, 1.6)), stribeck_velocity=_between(rng, 2e-3, 2e-2),
        stribeck_exponent=float(rng.uniform(0.8, 2.0)), viscous=_between(rng, 0.3, 2.0) * coulomb / speed,
        presliding=_between(rng, 2e-5, 1.5e-4), micro_damping=0.6 * math.sqrt(coulomb / 5e-5 * mass),
        asymmetry=float(rng.uniform(-0.03, 0.03)), counterpart=counterpart, spring=spring,
        spring_zero=float(rng.uniform(-0.03, 0.03)) * 1e-3 * stroke,
        spring_damping=0.02 * 2.0 * math.sqrt(spring * mass), pressure_gain=1.0, pressure_bias=0.0,
    )  # fmt: skip
    changed, size = _changed(rng, rig, kind, flow / 6e4)
    answers: dict[str, float | str] = {
        "bore": bore, "rod": rod, "rods": "two", "stroke": stroke, "supply_pressure": pressure, "rated_flow": flow,
        "rated_drop": 70.0,
    }  # fmt: skip
    guess = float(rng.uniform(0.75, 1.3)) * mass
    if not 50.0 <= mass <= 200.0 or rng.random() < 0.4:
        # The usual 100 kg strikes the engineer as wrong.
        answers["moving_mass"] = _rounded(guess, 1)
    if spring and not counterpart:
        answers["spring"] = _rounded(1e-3 * spring * float(rng.uniform(0.9, 1.1)), 2)
    if gravity:
        answers["rod_points"] = "up" if gravity > 0.0 else "down"
    if rng.random() < 0.4:
        answers["bandwidth"] = _rounded(rig.natural_frequency / (2.0 * math.pi), 1)
    return Stranger(
        seed, number, rig, changed, kind, size, answers, _sensors(rng, rig, force), _control(rng, rig), bool(rng.random() < 0.5)
    )


def _changed(rng: Rng, rig: Rig, kind: str, flow: float) -> tuple[Rig, float]:
    """Return the rig with a hidden change and the change's size; ``flow`` is the rated flow [m^3/s]."""
    up = 1.0 if rng.random() < 0.5 else -1.0
    if not kind:
        return rig, 0.0
    amount = _between(rng, *AMOUNTS[kind])
    signed, relative = up * amount, math.exp(up * amount) - 1.0
    leak, rubbed, volts = amount * flow / rig.source_pressure, signed * rig.coulomb, signed * FULL
    changes: dict[str, tuple[float, dict[str, Any]]] = {
        "leakage": (leak, {"laminar": rig.laminar + leak}),
        "bulk_modulus": (relative, {"modulus_factor": 1.0 + relative}),
        "coulomb": (rubbed, {"coulomb": rig.coulomb + rubbed, "static": rig.static + rubbed}),
        "viscous": (signed * rig.viscous, {"viscous": rig.viscous * (1.0 + signed)}),
        "mass": (relative, {"mass": rig.mass * (1.0 + relative)}),
        "flow_gain": (relative, {"edge_gain": rig.edge_gain * (1.0 + relative)}),
        "valve_null": (signed * TRAVEL, {"null": rig.null + volts}),
        "supply_pressure": (relative, {"source_pressure": rig.source_pressure * (1.0 + relative)}),
        "pressure_gain": (signed, {"pressure_gain": 1.0 + signed}),
        "pressure_bias": (signed * rig.source_pressure, {"pressure_bias": signed * rig.source_pressure}),
        "spring": (signed * rig.spring, {"spring": rig.spring * (1.0 + signed)}),
    }
    size, values = changes[kind]
    return rig._replace(**values), size


def _sensors(rng: Rng, rig: Rig, force: float) -> Sensors:
    full = np.array([1.25 * rig.source_pressure] * 3 + [rig.stroke, force, 2.0 * FULL])
    noise = full * np.exp(rng.uniform(np.log(1e-5), np.log(2e-4), READINGS))
    noise[READ_X] = rig.stroke * _between(rng, 3e-6, 3e-5)
    bits = rng.choice([14, 16, 16, 18], READINGS)
    resolution = full / 2.0**bits
    resolution[READ_X] = float(rng.choice([1e-6, 2e-6, 5e-6]))
    offset = full * rng.uniform(-1e-3, 1e-3, READINGS)
    return Sensors(noise, resolution, offset, bool(rng.random() < 0.8), bool(rng.random() < 0.6))


def _control(rng: Rng, rig: Rig) -> Control:
    """Tune a controller as an engineer would: a fraction of the lowest resonance."""
    rate = float(rng.choice(RATES))
    volume = 2.0 * rig.dead_volume + rig.area * rig.stroke
    oil = 4.0 * rig.modulus * rig.area**2 / volume
    resonance = math.sqrt((oil + rig.spring) / rig.mass)
    bandwidth = float(rng.uniform(0.05, 0.09)) * min(resonance, rig.natural_frequency, 0.5 * rate)
    per_volt = top_speed(rig) / FULL
    of_force = bool(rng.random() < (0.6 if rig.counterpart else 0.3)) and rig.spring > 0.0
    every = 2 if rate >= 2000.0 and rng.random() < 0.3 else 1
    if of_force:
        rigid = rig.spring if rig.counterpart else oil + rig.spring
        gain = bandwidth / (rigid * per_volt)
        return Control(rate, every, True, gain, gain * 0.3 * bandwidth, 0.8 / (rig.spring * per_volt))
    return Control(rate, every, False, bandwidth / per_volt, 0.15 * bandwidth**2 / per_volt, 0.9 / per_volt)


# --- files ----------------------------------------------------------------------------------------

HEADERS = {
    "time": ("Zeit [s]", "Time [s]"),
    "command": ("Stellsignal [V]", "Valve command [V]"),
    "spool": ("Schieberweg [V]", "Spool [V]"),
    READ_PA: ("Druck A [bar]", "Pressure A [bar]"),
    READ_PB: ("Druck B [bar]", "Pressure B [bar]"),
    READ_PS: ("Systemdruck [bar]", "Supply pressure [bar]"),
    READ_X: ("Kolbenweg [mm]", "Position [mm]"),
    READ_CELL: ("Kraftmessdose [kN]", "Load cell [kN]"),
}
"""Headers, German and English."""

VALVE_DATA = "10 V = 1 mm"
"""Data of the valve for the map of columns; the travel is the usual one, as only the flow counts."""


def table(stranger: Stranger, samples: Samples) -> str:
    """Return a recording as the text of a CSV file, as a data logger of the lab writes it."""
    sensors, r = stranger.sensors, samples.readings
    columns: list[tuple[object, Array, int]] = [("time", samples.time, 5), ("command", samples.command, 4)]
    if sensors.spool:
        columns.append(("spool", r[:, READ_SPOOL], 4))
    columns += [(READ_PA, 1e-5 * r[:, READ_PA], 4), (READ_PB, 1e-5 * r[:, READ_PB], 4)]
    if sensors.supply:
        columns.append((READ_PS, 1e-5 * r[:, READ_PS], 3))
    columns.append((READ_X, 1e3 * r[:, READ_X], 4))
    if stranger.rig.counterpart:
        columns.append((READ_CELL, 1e-3 * r[:, READ_CELL], 5))
    separator = ";" if stranger.german else ","
    lines = [separator.join(HEADERS[key][0 if stranger.german else 1] for key, _, _ in columns)]
    texts = [[f"{value:.{digits}f}" for value in values] for _, values, digits in columns]
    rows = (separator.join(row) for row in zip(*texts, strict=True))
    lines += [row.replace(".", ",") for row in rows] if stranger.german else rows
    return "\n".join(lines) + "\n"
