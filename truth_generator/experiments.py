"""Experiments: references and disturbances drawn from a seed.

A plan holds the reference force, position and speed and the disturbance at the control ticks. The controller
(`kernel.control`) feeds the speed forward and closes a slow PI loop on the force, a P loop on the position, or both. The
reference force follows from the motion, or the motion from the force, by the rig file's load model without hidden effects.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import bilinear, lfilter

Rng = np.random.Generator
TICK = 1.0e-3  # s, control period
LEADING_OVER = 2000  # ticks of the transition from one experiment to the next
# The paper's constant velocities, mm/s.
SPEEDS = (2, 3, 4, 6, 8, 10, 12, 14, 16, 20, 25, 30, 45, 60, 75, 90, 105, 120, 135, 150)


@dataclass
class Plan:
    """Plan of an experiment, one value per control tick; x0 is the piston's initial position."""

    force: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    disturbance: np.ndarray
    servo: np.ndarray
    w_force: float
    w_position: float
    x0: float
    servo_recorded: bool = False


EXPERIMENTS: dict[str, Callable[[Rng, np.ndarray, dict], Plan]] = {}


def experiment(builder):
    EXPERIMENTS[builder.__name__] = builder
    return builder


# ------------------------------------------------------------------------------------------------------------- pieces


def smooth(a: np.ndarray, rate: float) -> np.ndarray:
    """Return a signal after a critically damped second-order low-pass, initialised in steady state."""
    decay = math.exp(-rate * TICK)
    gain = 1.0 - decay
    for _ in range(2):
        a = a[0] + lfilter([gain], [1.0, -decay], a - a[0])
    return a


def multisine(rng: Rng, t: np.ndarray, low: float, high: float, tones: int) -> np.ndarray:
    """Return a sum of sines between two frequencies; amplitudes fall with frequency, the peak is 1."""
    out = np.zeros_like(t)
    edges = np.geomspace(low, high, tones + 1)
    for first, last in pairwise(edges):
        frequency = rng.uniform(first, last)
        out += frequency**-0.5 * rng.uniform(0.6, 1.4) * np.sin(2 * np.pi * frequency * t + rng.uniform(0, 2 * np.pi))
    return out / np.abs(out).max()


def window(n: int, edge: int) -> np.ndarray:
    """Return a window of ones with a cosine rise and fall at the ends."""
    edge = max(min(edge, n // 2), 1)
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(edge) / edge)
    out = np.ones(n)
    out[:edge] *= ramp
    out[n - edge :] *= ramp[::-1]
    return out


def rates(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return speed and acceleration of a motion."""
    v = np.gradient(x, TICK)
    return v, np.gradient(v, TICK)


def load_of(x: np.ndarray, rig: dict) -> np.ndarray:
    """Return the force a motion requires according to the rig file, with Coulomb friction, N."""
    plant, friction = rig["plant"], rig["friction"]
    v, a = rates(x)
    level = friction["coulomb_force"]
    return (
        plant["moving_mass"] * (a + plant["gravity"])
        + (plant["viscous_damping"] + friction["viscous_coefficient"]) * v
        + plant["spring_stiffness"] * x
        + level * np.tanh(v / 2e-3)
    )


def motion_of(force: np.ndarray, rig: dict) -> np.ndarray:
    """Return the motion under a force net of the disturbance, by the rig file without Coulomb friction, m."""
    plant = rig["plant"]
    damping = plant["viscous_damping"] + rig["friction"]["viscous_coefficient"]
    spring = max(plant["spring_stiffness"], 1.0e4)
    free = force - plant["moving_mass"] * plant["gravity"]
    b, a = bilinear([1.0], [plant["moving_mass"], damping, spring], fs=1.0 / TICK)
    return free[0] / spring + lfilter(b, a, free - free[0])


def from_motion(x: np.ndarray, fd: np.ndarray, rig: dict, servo: np.ndarray, **more) -> Plan:
    """Plan a motion under force control."""
    v, _ = rates(x)
    return Plan(load_of(x, rig) + fd, x, v, fd, servo, 1.0, 0.0, float(x[0]), **more)


def from_force(force: np.ndarray, fd: np.ndarray, rig: dict, servo: np.ndarray, **more) -> Plan:
    """Plan a force; the motion results from it."""
    x = motion_of(force - fd, rig)
    v, _ = rates(x)
    return Plan(force, x, v, fd, servo, 1.0, 0.0, float(x[0]), **more)


def at_position(x: np.ndarray, fd: np.ndarray, servo: np.ndarray) -> Plan:
    """Plan a motion under position control."""
    v, _ = rates(x)
    return Plan(np.zeros_like(x), x, v, fd, servo, 0.0, 1.0, float(x[0]))


def servo_motion(rng: Rng, t: np.ndarray, amplitude: float) -> np.ndarray:
    """Return a displacement of the position servo that starts from rest, m."""
    start = np.minimum(t / 1.0, 1.0)
    return amplitude * multisine(rng, t, 0.1, 1.5, 4) * start * start * (3.0 - 2.0 * start)


def quiet_servo(rng: Rng, t: np.ndarray) -> np.ndarray:
    """Return a servo displacement for experiments in which it matters only with a coupling to the beam."""
    return servo_motion(rng, t, rng.uniform(0.01, 0.025))


def ramps(rng: Rng, n: int, low: float, high: float) -> np.ndarray:
    """Return a back-and-forth motion at constant speeds between low and high, m/s, starting and ending at 0."""
    x, at = np.zeros(n), 0
    while at < n:
        speed = math.exp(rng.uniform(math.log(low), math.log(high))) * (1 if rng.random() < 0.5 else -1)
        length = int(min(rng.uniform(0.25, 1.2), 0.05 / abs(speed)) / TICK)
        rest = int(rng.uniform(0.0, 0.15) / TICK)
        rise = speed * TICK * np.arange(length)
        piece = np.concatenate([rise, np.full(rest, rise[-1]), rise[::-1], np.zeros(rest)])
        if at + piece.size > n:
            break
        x[at : at + piece.size] = piece
        at += piece.size
    return x


def bursts(rng: Rng, n: int) -> np.ndarray:
    """Return a sequence of small sines, 0.2 to 4 mm at 0.4 to 3 Hz, m."""
    x, at = np.zeros(n), 0
    while at < n:
        length = min(int(rng.uniform(1.5, 3.0) / TICK), n - at)
        t = TICK * np.arange(length)
        amplitude = math.exp(rng.uniform(math.log(0.2e-3), math.log(4e-3)))
        x[at : at + length] = amplitude * np.sin(2 * np.pi * rng.uniform(0.4, 3.0) * t) * window(length, 300)
        at += length
    return x


def wander_by(rng: Rng, n: int, speed: float) -> np.ndarray:
    """Return a multisine motion with a given peak speed, starting and ending at 0, m."""
    t = TICK * np.arange(n)
    x = multisine(rng, t, 0.08, rng.uniform(1.0, 2.5), 6) * window(n, min(2000, n // 3))
    v = np.abs(np.gradient(x, TICK)).max()
    x *= speed / v
    return x * min(1.0, 0.085 / np.abs(x).max())


# -------------------------------------------------------------------------------------------------------- experiments


@experiment
def rich(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """Multisines, ramps and small sines in turn, 0.5 mm/s to 0.2 m/s, against a multisine of some kN."""
    servo = quiet_servo(rng, t)
    n = t.size
    parts = ["wander", "ramps", "bursts", "wander"]
    shares = np.array([0.32, 0.22, 0.16, 0.30])
    order = rng.permutation(4)
    cuts = np.concatenate([[0], np.cumsum(np.round(shares[order] * n).astype(int))])
    cuts[-1] = n
    x = np.zeros(n)
    for i, part in enumerate(order):
        length = int(cuts[i + 1] - cuts[i])
        if length < 50:
            continue
        if parts[part] == "wander":
            piece = wander_by(rng, length, rng.uniform(0.17, 0.24))
        elif parts[part] == "ramps":
            piece = ramps(rng, length, 0.5e-3, 0.12)
        else:
            piece = bursts(rng, length)
        x[cuts[i] : cuts[i + 1]] = piece
    x = smooth(x, 60.0) + rng.uniform(-0.012, 0.012)
    start = np.minimum(t / 0.5, 1.0)
    fd = rng.uniform(2e3, 5e3) * multisine(rng, t, 0.1, rng.uniform(2.0, 4.0), 6) * start * start * (3.0 - 2.0 * start)
    return from_motion(x, fd, rig, servo)


@experiment
def paper_sine(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """10 sin(pi t) kN against 5 sin(2 pi t) kN."""
    servo = quiet_servo(rng, t)
    return from_force(1e4 * np.sin(np.pi * t), 5e3 * np.sin(2 * np.pi * t), rig, servo)


@experiment
def paper_constant(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """10 kN, reached in a second and a half, against 2 sin(pi/2 t) kN."""
    servo = quiet_servo(rng, t)
    start = np.clip(t / 1.5, 0.0, 1.0)
    return from_force(1e4 * start * start * (3.0 - 2.0 * start), 2e3 * np.sin(0.5 * np.pi * t), rig, servo)


@experiment
def steps(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """The reference force steps every one to three seconds, within +-2.5 kN of the weight; the disturbance is weak and slow."""
    servo = quiet_servo(rng, t)
    weight = rig["plant"]["moving_mass"] * rig["plant"]["gravity"]
    force = np.full(t.size, weight)  # from mid-stroke
    at = 300
    while at < t.size:
        length = int(rng.uniform(1.0, 3.0) / TICK)
        force[at : at + length] = weight + rng.uniform(-2.5e3, 2.5e3)
        at += length
    fd = rng.uniform(0.3e3, 1.0e3) * multisine(rng, t, 0.05, 0.6, 3) * np.minimum(t / 0.5, 1.0)
    plan = from_force(smooth(force, 8.0), fd, rig, servo)
    plan.force = force
    return plan


@experiment
def slow_sweep(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """Position loop: the paper's constant speeds in both directions, in random order, as many as the duration allows."""
    servo = quiet_servo(rng, t)
    x, at = np.zeros(t.size), 0
    speeds = 1e-3 * np.array(SPEEDS)
    order = rng.permutation(speeds)
    i = 0
    while at < t.size:
        speed = order[i % order.size] * (1 if rng.random() < 0.5 else -1)
        i += 1
        length = int(min(0.8, 0.08 / abs(speed)) / TICK)
        rise = speed * TICK * np.arange(length)
        piece = np.concatenate([rise, np.full(100, rise[-1]), rise[::-1], np.zeros(100)])[: t.size - at]
        x[at : at + piece.size] = piece
        at += piece.size
    return at_position(smooth(x, 80.0) + rng.uniform(-0.02, 0.02), np.zeros(t.size), servo)


@experiment
def presliding(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """Position loop: slow sines of 0.1 to 1.5 mm around one position."""
    servo = quiet_servo(rng, t)
    frequency = rng.uniform(0.15, 0.5)
    amplitude = 0.8e-3 + 0.7e-3 * np.sin(2 * np.pi * t * rng.uniform(0.02, 0.05) + rng.uniform(0, 6.28))
    x = amplitude * np.sin(2 * np.pi * frequency * t) * np.minimum(t, 1.0)
    return at_position(x + rng.uniform(-0.02, 0.02), np.zeros(t.size), servo)


@experiment
def servo(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """The position servo moves by some 10 mm; the force on the beam without the coupling is recorded as fd."""
    displacement = servo_motion(rng, t, rng.uniform(0.015, 0.035))
    x = smooth(wander_by(rng, t.size, rng.uniform(0.08, 0.16)), 60.0)
    fd = rng.uniform(0.3e3, 1.2e3) * multisine(rng, t, 0.1, 1.5, 4) * np.minimum(t / 0.5, 1.0)
    return from_motion(x, fd, rig, displacement, servo_recorded=True)


@experiment
def rest(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """Position loop: the beam hangs in its spring at equilibrium, at zero pressure and without motion."""
    zero = np.zeros(t.size)
    plant = rig["plant"]
    x0 = -plant["moving_mass"] * plant["gravity"] / plant["spring_stiffness"] if plant["spring_stiffness"] > 0 else 0.0
    return at_position(zero + x0, zero, zero)


@experiment
def tiny(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """Position loop: slow sine of 10 to 40 um."""
    servo = np.zeros(t.size)
    x = rng.uniform(1e-5, 4e-5) * np.sin(2 * np.pi * rng.uniform(0.2, 0.6) * t) * np.minimum(t, 1.0)
    return at_position(x, np.zeros(t.size), servo)


@experiment
def random(rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """Reference and disturbance of random type, amplitude and spectrum."""
    servo = quiet_servo(rng, t)
    kind = int(rng.integers(4))
    peak = rng.uniform(1.5e3, 5e3)
    low, high = rng.uniform(0.05, 0.2), rng.uniform(0.6, 3.0)
    if kind == 0:
        shape = multisine(rng, t, low, high, int(rng.integers(3, 9)))
    elif kind == 1:  # noise
        shape = smooth(rng.standard_normal(t.size), 2 * np.pi * rng.uniform(0.4, 1.5))
        shape /= np.abs(shape).max()
    elif kind == 2:  # triangles
        phase = rng.uniform(0.1, 0.6) * t
        shape = smooth(4.0 * np.abs(phase - np.floor(phase + 0.5)) - 1.0, 40.0)
    else:  # a sweep
        shape = np.sin(2 * np.pi * (low * t + 0.5 * (high - low) * t * t / max(t[-1], TICK)))
    start = np.minimum(t / 0.5, 1.0)
    start = start * start * (3.0 - 2.0 * start)
    force = (rng.uniform(-1.5e3, 1.5e3) + peak * shape) * start
    fd = np.zeros(t.size)
    if rng.random() < 0.8:
        fd = rng.uniform(0.5e3, 4e3) * multisine(rng, t, 0.1, rng.uniform(0.6, 4.0), int(rng.integers(1, 7))) * start
    weight = rig["plant"]["moving_mass"] * rig["plant"]["gravity"]
    x = motion_of(weight + force - fd, rig)
    v, _ = rates(x)
    over = max(np.abs(x).max() / 0.15, np.abs(v).max() / 0.4, 1.0)
    return from_force(weight + force / over, fd / over, rig, servo)


def planned(name: str, rng: Rng, t: np.ndarray, rig: dict) -> Plan:
    """Plan one experiment, or a sequence with the same kind of loop, joined by `+`, with smooth transitions.

    Raises:
        KeyError: unknown experiment.
        ValueError: experiments under force control and under position control in one run.
    """
    names = name.split("+")
    if len(names) == 1:
        return EXPERIMENTS[name](rng, t, rig)
    edges = np.round(np.linspace(0, t.size, len(names) + 1)).astype(int)
    whole: Plan | None = None
    for one, first, last in zip(names, edges[:-1], edges[1:], strict=True):
        begin = max(first - LEADING_OVER, 0)
        plan = EXPERIMENTS[one](rng, t[: last - begin], rig)
        whole = plan if whole is None else _followed(whole, plan, first - begin)
    return whole


def _followed(before: Plan, after: Plan, over: int) -> Plan:
    """Return a plan blended into the next one over its last ticks."""
    if (before.w_force, before.w_position) != (after.w_force, after.w_position):
        raise ValueError("one run is under force control or under position control, not both")
    share = np.linspace(0.0, 1.0, over)
    share = share * share * (3.0 - 2.0 * share)

    def joined(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.concatenate([a[:-over], a[-over:] + share * (b[:over] - a[-over:]), b[over:]])

    signals = {key: joined(getattr(before, key), getattr(after, key)) for key in ("force", "position", "disturbance", "servo")}
    recorded = before.servo_recorded or after.servo_recorded
    speed = rates(signals["position"])[0]
    return Plan(
        **signals, speed=speed, w_force=before.w_force, w_position=before.w_position, x0=before.x0, servo_recorded=recorded
    )
