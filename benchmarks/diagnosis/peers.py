"""Simpler methods on the same residuals: forward selection by BIC, and pysindy's sparse regression.

Both get the whitened residuals of the given model and a library of named functions of the recorded signals, averaged over the
same windows. They name the effects whose functions they keep, the surest first, and nothing if they keep none; they have no
verdict `unknown`. Names joined by `|` are effects with the same function: either is right.
"""

import time
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.record import (
    COMMAND,
    LOAD,
    PRESSURE,
    SERVO_POSITION,
    SPOOL,
    SUPPLY,
    TEMPERATURE,
    prepare,
)
from ehls_ros.diagnosis.stages import Channel, setup
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory

WITH_PYSINDY = find_spec("pysindy") is not None
"""Whether pysindy is installed."""

if WITH_PYSINDY:
    from pysindy import STLSQ

PENALTY = 32.0
"""Cost of a coefficient, in units of BIC's log n (chosen by `--tune`): windows overlap, and no model is exact."""

LEAST_EXPLAINED = 0.05
"""Fraction of a channel's residual a sparse model must explain on held-out blocks to be kept (chosen by `--tune`)."""

DEVIATIONS = 0.0
"""Standard errors by which a sparser model may exceed the least held-out error (chosen by `--tune`)."""

SENSOR_CHANNELS: frozenset[Channel] = frozenset({"cell", "velocity"})
"""Channels in which two sensors of one quantity are compared."""

MOST_NAMED = 4
"""Maximum number of effects named."""

THRESHOLDS = 24
"""Number of thresholds of STLSQ tried."""

RIDGE = 1e-3
"""Ridge of STLSQ, as a fraction of the number of rows."""

REFERENCE_TEMPERATURE = 313.15
"""Oil temperature for which the rig file's friction holds [K]."""


class Term(NamedTuple):
    """One function of the library.

    Attributes:
        effect: name of its effect.
        variant: terms of one effect and variant are selected together.
        values: its mean over the windows of each channel in which it shows, in units of the noise floor.
    """

    effect: str
    variant: int
    values: dict[Channel, Array]


class Problem(NamedTuple):
    """Inputs of the peers.

    Attributes:
        residuals: whitened, by channel.
        blocks: the block each window lies in, by channel.
        terms: the library.
        wall_s: time of the preparation [s].
    """

    residuals: dict[Channel, Array]
    blocks: dict[Channel, NDArray[np.intp]]
    terms: list[Term]
    wall_s: float


def problem_of(trajectory: Trajectory, rig: Rig) -> Problem:
    """Return the residuals and the library for a recording with all signals of the data contract."""
    began = time.perf_counter()
    record = prepare(trajectory, rig, "case")
    evidence = gather(record, rig, setup(record, rig), 0)
    terms = library(evidence, rig)
    return Problem(
        {c: evidence.base.values[c] for c in evidence.channels},
        {c: evidence.block[c] for c in evidence.channels},
        terms,
        time.perf_counter() - began,
    )


# ---------------------------------------------------------------------------------------------------------- the library


def library(evidence: Evidence, rig: Rig) -> list[Term]:
    """Return the functions that a careful engineer would try, for every listed effect."""
    record, comparison, plant = evidence.record, evidence.comparison(), rig.plant
    dt, signals = record.period, record.signals
    given = rig.effective()
    motion = comparison.motion(given)
    x, v, p = motion.position, motion.velocity, motion.pressure
    xv, u, fd, ps = signals[SPOOL], signals[COMMAND], signals[LOAD], signals[SUPPLY]
    a = np.gradient(v, dt)
    dp = comparison.local_fit(signals[PRESSURE], 1)
    level = rig.friction.coulomb_force
    friction = comparison.friction(given)[:, 0]
    rub = (friction - rig.friction.viscous_coefficient * v) / level
    side = np.tanh(v / 1e-3)
    one = np.ones_like(x)
    root = np.sqrt(np.maximum(ps - np.sign(xv) * p, 0.0))
    flow = np.abs(xv) * root
    spool = comparison.simulated_spool(given)
    rate = np.gradient(spool, dt)
    behind = lag(rate, plant.valve_bandwidth, dt)
    first, second = (np.maximum(0.5 * (plant.supply_pressure + s * p), 1e3) for s in (1.0, -1.0))
    warmer = signals[TEMPERATURE] - REFERENCE_TEMPERATURE
    out: list[Term] = []

    def add(effect: str, variant: int = 0, **shows: Array) -> None:
        """Add a function, one coefficient for all channels."""
        means = {c: evidence.means(c, shows[c]) / evidence.floor[c] for c in evidence.channels if c in shows}
        if means:
            out.append(Term(effect, variant, means))

    def rubs(**changes: float) -> Array:
        """Return the change of the friction force with a change of the model's coefficients."""
        changed = {
            name: getattr(rig.friction, name) * factor for name, factor in changes.items() if name != "element_stiffness"
        }
        if "element_stiffness" in changes:
            changed["element_stiffness"] = tuple(changes["element_stiffness"] * k for k in rig.friction.element_stiffness)
        moved: Array = comparison.friction(rig._replace(friction=rig.friction._replace(**changed)).effective())[:, 0] - friction
        return moved

    def read_wrong(effect: str, pressure: Array) -> None:
        """Add the effect of an error in the measured pressure."""
        force = plant.piston_area * pressure
        stored = plant.total_volume / (4.0 * plant.bulk_modulus) * np.gradient(pressure, dt)
        add(effect, 0, cell=force, force=force, volume=-stored - plant.leakage_coefficient * pressure)

    def placed_wrong(effect: str, position: Array) -> None:
        """Add the effect of an error in the measured position."""
        speed = np.gradient(position, dt)
        force = plant.moving_mass * np.gradient(speed, dt) + plant.viscous_damping * speed + plant.spring_stiffness * position
        add(effect, 0, velocity=-speed, volume=plant.piston_area * speed, force=force)

    # valve
    add("valve_null_bias", 0, spool=one)
    add("valve_null_bias", 1, volume=root)
    add("valve_gain_shift", 0, spool=spool)
    add("valve_gain_shift", 1, volume=xv * root)
    add("valve_gain_asymmetry", 0, spool=lag(np.abs(u), plant.valve_bandwidth, dt))
    add("valve_gain_asymmetry", 1, volume=flow)
    add("valve_dead_zone", 0, volume=np.tanh(xv / 1e-5) * root)
    add("valve_bandwidth_shift", 0, spool=behind)
    add("valve_second_order", 0, spool=np.gradient(rate, dt))
    add("valve_second_order", 0, spool=rate)
    add("command_delay", 0, spool=rate)
    for i, width in enumerate((5e-6, 20e-6, 60e-6)):
        add("valve_hysteresis", i, spool=play(spool, width) - spool)
    for i, part in enumerate((0.3, 0.5, 0.7)):
        add("valve_saturation", i, spool=beyond(spool, part * float(np.abs(spool).max())))
    # flow
    add("supply_pressure_droop", 0, supply=flow)
    add("supply_pressure_droop", 1, supply=lag(flow, 10.0, dt))
    add("supply_pressure_droop", 2, supply=lag(flow, 3.0, dt))
    add("bulk_modulus_shift", 0, volume=dp)
    add("entrained_air", 0, volume=dp * (first**-1.75 + second**-1.75))
    add("internal_leakage_shift", 0, volume=p)
    add("turbulent_leakage", 0, volume=np.sign(p) * np.sqrt(np.abs(p)))
    add("external_leakage", 0, volume=first)
    add("external_leakage", 1, volume=second)
    # friction
    add("coulomb_shift", 0, force=rubs(coulomb_force=1.02, static_force=1.0 + 0.02 * level / rig.friction.static_force))
    add("coulomb_asymmetry", 0, force=np.abs(side))
    add("viscous_shift", 0, force=v)
    add("viscous_asymmetry", 0, force=np.abs(v))
    add("stribeck_shift", 0, force=rubs(static_force=1.1))
    add("stribeck_shift", 1, force=rubs(stribeck_velocity=2.0))
    add("presliding_stiffness_shift", 0, force=rubs(element_stiffness=1.3))
    add("pressure_dependent_friction", 0, force=np.abs(p) * rub)
    add("position_dependent_friction", 0, force=x * rub)
    add("temperature_dependent_friction", 0, force=warmer * v)
    add("temperature_dependent_friction", 1, force=warmer * rub)
    # mechanics
    add("mass_shift", 0, force=a + plant.gravity)
    add("spring_rate_shift", 0, force=x)
    add("spring_hardening", 0, force=x**3)
    add("hinge_backlash", 0, force=np.tanh(x / 3e-4))
    for i, gap in enumerate((2e-4, 1e-3), 1):
        add("hinge_backlash", i, force=play(x, gap) - x)
    for i, part in enumerate((0.7, 0.85, 0.95)):
        add("end_stop", i, force=np.maximum(x - np.quantile(x, part), 0.0))
        add("end_stop", i + 3, force=np.maximum(np.quantile(x, 1.0 - part) - x, 0.0))
    for i, frequency in enumerate((3.0, 6.0, 12.0, 25.0)):
        add("flexible_mode", i, force=resonator(a, frequency, dt))
    # environment
    add("constant_load|position_sensor_bias", 0, force=one)
    for i, frequency in enumerate(lines(evidence, 3)):
        angle = 2.0 * np.pi * frequency * record.time
        add("periodic_disturbance", i, force=np.sin(angle))
        add("periodic_disturbance", i, force=np.cos(angle))
    if SERVO_POSITION in record:
        add("coupling_stiffness", 0, force=signals[SERVO_POSITION] - x)
    # sensors
    read_wrong("pressure_sensor_bias", one)
    read_wrong("pressure_sensor_gain", p)
    read_wrong("pressure_sensor_lag|sensor_delay", dp)
    placed_wrong("position_sensor_gain", x)
    placed_wrong("sensor_delay", v)
    add("sensor_delay", 1, force=np.gradient(fd, dt), spool=-rate)
    return out


def lag(values: Array, rate: float, dt: float) -> Array:
    """Return a signal after a first-order lag."""
    decay = np.exp(-rate * dt)
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], values - values[0]) + values[0])


def resonator(values: Array, frequency: float, dt: float) -> Array:
    """Return the response of a lightly damped oscillator to an acceleration."""
    rate, damping = 2.0 * np.pi * frequency, 0.07
    turn = np.exp(-damping * rate * dt) * np.exp(1j * rate * np.sqrt(1.0 - damping**2) * dt)
    return np.asarray(lfilter([rate * dt], [1.0, -2.0 * turn.real, abs(turn) ** 2], values))


def play(values: Array, width: float) -> Array:
    """Return a signal after play."""
    out, half = np.empty_like(values), 0.5 * width
    at = float(values[0])
    for i, value in enumerate(values.tolist()):
        at = min(max(at, value - half), value + half)
        out[i] = at
    return out


def beyond(values: Array, limit: float) -> Array:
    """Return the part of a signal beyond a limit."""
    return values - np.clip(values, -limit, limit)


def lines(evidence: Evidence, count: int) -> list[float]:
    """Return the strongest frequencies of the force residual [Hz]."""
    if "force" not in evidence.channels:
        return []
    e, t = np.clip(evidence.base.values["force"], -20.0, 20.0), evidence.times["force"]
    step = float(np.median(np.diff(t)))
    even = np.interp(np.arange(t[0], t[-1], step), t, e)
    spectrum = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(len(even)), 8 * len(even)))
    frequency = np.fft.rfftfreq(8 * len(even), step)
    spectrum[frequency < 0.3] = 0.0
    found = []
    for _ in range(count):
        found.append(float(frequency[np.argmax(spectrum)]))
        spectrum[np.abs(frequency - found[-1]) < 3.0 / (len(even) * step)] = 0.0
    return found


# ------------------------------------------------------------------------------------------------------------ the peers


def bic(problem: Problem, penalty: float = PENALTY) -> list[str]:
    """Add the effect that lowers the information criterion most, until none does.

    The criterion is n log(RSS/n) summed over the channels, and log n for each coefficient; each step weights the channels by
    the residual of the previous one.
    """
    channels = list(problem.residuals)
    ends = np.cumsum([len(problem.residuals[c]) for c in channels])
    parts = {c: slice(end - len(problem.residuals[c]), end) for c, end in zip(channels, ends.tolist(), strict=True)}
    cost = penalty * np.log(ends[-1])
    e = np.concatenate([problem.residuals[c] for c in channels])
    groups: dict[tuple[str, int], Array] = {}
    for term in problem.terms:
        column = np.zeros((len(e), 1))
        for channel, values in term.values.items():
            column[parts[channel], 0] = values
        key = (term.effect, term.variant)
        groups[key] = np.column_stack([groups[key], column]) if key in groups else column

    def squares(values: Array) -> dict[Channel, float]:
        return {c: max(float(values[part] @ values[part]), 1e-12) for c, part in parts.items()}

    chosen, rest, named = np.empty((len(e), 0)), e, list[str]()
    while len(named) < MOST_NAMED:
        weight = np.concatenate([np.full(len(e[parts[c]]), np.sqrt(len(e[parts[c]]) / s)) for c, s in squares(rest).items()])
        basis = independent(weight[:, None] * chosen, np.empty((len(e), 0)))
        whole = weight * e
        whole = whole - basis @ (basis.T @ whole)
        before, best, found = squares(whole / weight), 0.0, None
        for (effect, variant), columns in groups.items():
            if effect in named:
                continue
            fresh = independent(weight[:, None] * columns, basis)
            left = (whole - fresh @ (fresh.T @ whole)) / weight
            after = squares(left)
            gain = sum(len(e[parts[c]]) * np.log(before[c] / after[c]) for c in channels)
            if gain - cost * fresh.shape[1] > best:
                best, found = gain - cost * fresh.shape[1], (effect, variant, left)
        if found is None:
            break
        named.append(found[0])
        chosen, rest = np.column_stack([chosen, groups[found[:2]]]), found[2]
    return named


def independent(columns: Array, basis: Array) -> Array:
    """Return an orthonormal basis of the part of the columns outside another basis."""
    scale = np.linalg.norm(columns, axis=0)
    columns = columns[:, scale > 0.0] / scale[scale > 0.0]
    if not columns.shape[1]:
        return columns
    rest = columns - basis @ (basis.T @ columns)
    rest = rest - basis @ (basis.T @ rest)
    q, r = np.linalg.qr(rest)
    return q[:, np.abs(np.diag(r)) > 1e-6]


class Path(NamedTuple):
    """Sparse regressions of a channel, one for each threshold, the last of which keeps nothing.

    Attributes:
        terms: the terms that may be kept.
        columns: their values, shape (windows, terms), each with a mean square of 1.
        thresholds: ascending, the last infinite.
        squares: mean squared error on held-out data, shape (thresholds, blocks).
    """

    terms: list[Term]
    columns: Array
    thresholds: Array
    squares: Array


def paths(problem: Problem) -> dict[Channel, Path]:
    """Fit each channel with every threshold on each half of the blocks and evaluate it on the other half."""
    out = {}
    for channel, e in problem.residuals.items():
        alone = channel in SENSOR_CHANNELS
        terms = [t for t in problem.terms if channel in t.values and (alone or not SENSOR_CHANNELS & set(t.values))]
        columns = np.column_stack([term.values[channel] for term in terms])
        columns = columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
        blocks = problem.blocks[channel]
        count = np.maximum(np.bincount(blocks), 1)
        thresholds = np.append(np.geomspace(0.03, max(float(np.abs(e).max()), 1.0), THRESHOLDS), np.inf)
        squares = []
        for threshold in thresholds:
            left = e.copy()
            for train in (blocks % 2 == 0, blocks % 2 == 1):
                left[~train] -= columns[~train] @ _fit(columns[train], e[train], float(threshold))
            squares.append(np.bincount(blocks, left * left) / count)
        out[channel] = Path(terms, columns, thresholds, np.array(squares))
    return out


def stlsq(
    problem: Problem, tried: dict[Channel, Path] | None = None, deviations: float = DEVIATIONS, least: float = LEAST_EXPLAINED
) -> list[str]:
    """Fit each channel by pysindy's sequentially thresholded least squares and name the effects of the terms kept.

    The threshold is the best on held-out data, or a sparser one that is as good. Sensor faults are named by the channels that
    only they affect, and come first; effects of the rig are named by all other channels.
    """
    weight: dict[str, tuple[bool, float]] = {}
    for channel, path in (paths(problem) if tried is None else tried).items():
        means = path.squares.mean(axis=1)
        # Compared with the best block by block, since their errors are correlated.
        excess = path.squares - path.squares[np.argmin(means)]
        bound = deviations * excess.std(axis=1) / np.sqrt(excess.shape[1])
        sparsest = int(np.flatnonzero(excess.mean(axis=1) <= bound + 1e-12).max())
        if means[sparsest] > (1.0 - least) * means[-1]:
            continue
        kept = np.abs(_fit(path.columns, problem.residuals[channel], float(path.thresholds[sparsest])))
        for term, size in zip(path.terms, kept.tolist(), strict=True):
            if size > 0.0:
                weight[term.effect] = max(weight.get(term.effect, (False, 0.0)), (channel in SENSOR_CHANNELS, size))
    return sorted(weight, key=lambda name: weight[name], reverse=True)[:MOST_NAMED]


def _fit(columns: Array, e: Array, threshold: float) -> Array:
    if not np.isfinite(threshold):
        return np.zeros(columns.shape[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # keeping no term is a valid result
        optimiser = STLSQ(threshold=threshold, alpha=RIDGE * len(e), max_iter=20)
        return np.asarray(optimiser.fit(columns, e[:, None]).coef_, dtype=np.float64).ravel()


PEERS: dict[str, Callable[[Problem], list[str]]] = {
    "forward selection by BIC": lambda problem: bic(problem, 1.0),
    f"the same, {PENALTY:g} log n for log n": bic,
}
if WITH_PYSINDY:
    PEERS["pysindy STLSQ"] = stlsq
