"""Effect of the sensors' noise on each residual, estimated by adding more noise to the recording."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.loss import rms
from ehls_ros.diagnosis.record import COMMAND, HELD, LOAD, SERVO_POSITION, SERVO_VELOCITY, Record
from ehls_ros.diagnosis.stages import VOLUMES, Channel, Comparison
from ehls_ros.diagnosis.windows import OVERLAP
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import noise_of

REALISATIONS = 8
"""Realisations of sensor noise that the noise floor is averaged over."""

FAST_SAMPLES = 0.75
"""Quantile of a signal's rate above which more noise than there is due to jitter."""

VARIANCE_WINDOWS = 9
"""Windows over which the noise variance and the error of an unseen command, which a lagging spool remembers, are smoothed."""

MIN_VARIANCE = 0.5
"""Least noise variance of a window, as a fraction of the channel's median variance."""

EXACT = (COMMAND, LOAD, SERVO_POSITION, SERVO_VELOCITY)
"""Signals that are commanded, not measured, unless listed in the record's ``measured``: they carry no sensor noise."""


def deviations(record: Record) -> dict[str, Array]:
    """Return the standard deviation of each sample's noise, by signal, shape (n,).

    With sampling jitter, noise grows with the signal's rate. The jitter is estimated from signals that move fast relative to
    their noise. Third differences of other signals contain more than noise, so their jitter is limited to that estimate.
    """
    exact = without_noise(record)
    sampling = {
        name: _sampling(values, record)
        for name, values in record.signals.items()
        if name not in HELD and name not in record.own
    }
    most = max((found.jitter for found in sampling.values() if found.clear), default=0.0)
    out = {}
    for name, values in record.signals.items():
        level, jitter = 0.0 if name in exact else record.noise[name], 0.0
        found = sampling.get(name)
        if found is not None and most > 0.0:
            jitter = min(found.jitter, most)
            level = found.steady if found.clear and jitter > 0.0 else level
        out[name] = np.hypot(level, jitter * record.by_stretch(np.gradient, values))
    return out


def without_noise(record: Record) -> frozenset[str]:
    """Return the signals that were commanded and not measured, which have no sensor's noise."""
    return frozenset(name for name in EXACT if name not in record.measured)


class Sampling(NamedTuple):
    """Sampling quality estimated from a signal.

    Attributes:
        jitter: standard deviation of the sampling instants, in sampling periods; 0 if none is detected.
        steady: standard deviation of the noise that does not grow with the signal's rate.
        clear: whether the signal moves fast enough relative to its noise for an estimate.
    """

    jitter: float
    steady: float
    clear: bool


def _sampling(values: Array, record: Record) -> Sampling:
    """Separate noise that grows with a signal's rate from the rest."""
    rate = record.by_stretch(np.gradient, values)
    # Differences across a pause are none of the signal's.
    inside = ~(record.fresh[1:-2] | record.fresh[2:-1] | record.fresh[3:])
    speed = 0.5 * np.abs(rate[1:-2] + rate[2:-1])[inside]
    fast, slow = speed >= np.quantile(speed, FAST_SAMPLES), speed <= np.median(speed)
    quickly, slowly = (float(np.mean(speed[part] ** 2)) for part in (fast, slow))
    differences = np.diff(values, 3)[inside]
    more, less = (noise_of(differences[part]) ** 2 for part in (fast, slow))
    if quickly <= slowly:
        return Sampling(0.0, math.sqrt(less), clear=False)
    jitter = min(math.sqrt(max(more - less, 0.0) / (quickly - slowly)), rules.MAX_JITTER)
    clear = quickly > rules.FAST_RATE**2 * less
    if jitter < rules.MIN_JITTER:
        return Sampling(0.0, math.sqrt(less), clear)
    return Sampling(jitter, math.sqrt(max(less - jitter**2 * slowly, 0.0)), clear)


def with_noise(record: Record, deviation: Mapping[str, Array], rng: np.random.Generator) -> Record:
    """Return the record with added noise of the sensors' level.

    Args:
        record: the recording.
        deviation: of each sample's noise, by signal, from :func:`deviations`.
        rng: random generator of the noise.
    """
    noisy = {
        name: values + deviation[name] * rng.standard_normal(len(values)) if np.any(deviation[name]) else values
        for name, values in record.signals.items()
    }
    return record._replace(signals=noisy)


def scatter(
    comparison: Comparison,
    rig: Rig,
    raw: Mapping[Channel, Array],
    deviation: Mapping[str, Array],
    seed: int,
    realisations: int = REALISATIONS,
) -> tuple[dict[Channel, Array], list[dict[Channel, Array]]]:
    """Return the standard deviation of each window's residual for a correct model, by channel.

    Returned with it is the change of the residuals by each realisation of the noise.

    Args:
        comparison: of the recording.
        rig: the given model.
        raw: its residuals, in each channel's unit.
        deviation: of each sample's noise, by signal.
        seed: of the added noise.
        realisations: number of realisations.
    """
    rng = np.random.default_rng(seed)
    record, channels = comparison.record, tuple(raw)
    squares, added = {c: np.zeros(len(raw[c])) for c in channels}, list[dict[Channel, Array]]()
    for _ in range(realisations):
        again = Comparison(with_noise(record, deviation, rng), comparison.setup).residuals(rig, channels)
        added.append({c: again[c] - raw[c] for c in channels})
        for c in channels:
            squares[c] += added[-1][c] ** 2
    led: Mapping[Channel, Array] = raw
    if record.period > rules.UNSEEN_PERIOD and COMMAND in record:
        # A command sent between two samples was not recorded; the error is at most one sample of lead.
        early = dict(record.signals) | {COMMAND: np.append(record.signals[COMMAND][1:], record.signals[COMMAND][-1])}
        led = Comparison(record._replace(signals=early), comparison.setup).residuals(rig, channels)
    smeared = Comparison(record, comparison.setup.with_wider_fit()).residuals(rig, channels)
    out = {}
    for c in channels:
        variance = squares[c] / realisations
        typical = float(np.median(variance))
        local = scipy.ndimage.uniform_filter1d(variance, VARIANCE_WINDOWS, mode="nearest")
        unresolved = scipy.ndimage.uniform_filter1d((smeared[c] - raw[c]) ** 2, OVERLAP, mode="nearest")
        unresolved += scipy.ndimage.uniform_filter1d((led[c] - raw[c]) ** 2, VARIANCE_WINDOWS, mode="nearest")
        out[c] = np.sqrt(np.maximum(local, MIN_VARIANCE * typical) + unresolved)
    return out, added


def largest_terms(comparison: Comparison, rig: Rig) -> dict[Channel, float]:
    """Return the rms of the largest term in each channel's balance, in the channel's unit."""
    plant, record = rig.effective().plant, comparison.record
    sizes = {name: rms(values) for name, values in record.signals.items()}
    flows = {c: rms(comparison.flow(rig, c)) for c in VOLUMES if c in comparison.setup.channels}
    moving = not {"force", "velocity"}.isdisjoint(comparison.setup.channels)
    speed = rms(comparison.motion(rig.effective()).velocity) if moving else 0.0
    # Beside a signal that is 0 throughout, the other one of the pair is the largest term.
    driving = plant.piston_area * sizes.get("load_pressure_pa", 0.0) or sizes.get("force_n", 0.0)
    return {
        "spool": sizes.get("spool_m", 0.0) or plant.valve_gain * sizes.get(COMMAND, 0.0),
        **{c: max(flows.get(c, 0.0), plant.piston_area * speed) for c in VOLUMES},
        "supply": sizes.get("supply_pressure_pa", 0.0),
        "force": max(driving, sizes.get("disturbance_force_n", 0.0)),
        "cell": driving,
        "velocity": speed,
    }
