"""Preparation of a recording for diagnosis: signals on a uniform time base, with masks of the valid samples."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.contradictions import check_suits
from ehls_ros.errors import BadInput
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask, filled, inliers, noise, noise_between_moves
from ehls_ros.trajectory import EQUAL_AREAS_ASSUMED, OF_CHAMBERS, PRESSURE_A, PRESSURE_B, Own, Trajectory, has_both_chambers

MAX_RECORDING = 150.0
"""Longest recording that is used completely; a longer one is sampled in stretches of this total [s]."""

STRETCHES = 15
"""Stretches taken of a longer recording, spread evenly over it."""

PAUSE, PAUSE_STEPS = 1.0, 100.0
"""Step between two samples from which a new stretch begins [s], and the same in sampling periods; the larger one counts."""

SAME_PERIOD = 0.02
"""Relative difference of sampling periods up to which recordings are of one rate."""

SPIKE_NEIGHBOURS = 41
"""Samples over which the median change around a command is taken."""

MIN_SPIKE = 1e-6
"""Fraction of the largest command below which a jump is rounding and not a spike."""

RESOLUTION_SAMPLES = 20000
"""Samples in which a signal's resolution is looked for."""

RESOLUTION_MISFIT = 1e-3
"""Largest distance of a difference from a multiple of the smallest step for that step to be a resolution."""

COMMAND, SPOOL, PRESSURE, SUPPLY = "valve_command_m", "spool_m", "load_pressure_pa", "supply_pressure_pa"
POSITION, VELOCITY, FORCE, LOAD = "position_m", "velocity_m_s", "force_n", "disturbance_force_n"
TANK = "tank_pressure_pa"
TEMPERATURE, SERVO_POSITION, SERVO_VELOCITY = "oil_temperature_k", "disturbance_displacement_m", "disturbance_velocity_m_s"

USED = (
    COMMAND, SPOOL, PRESSURE, SUPPLY, POSITION, VELOCITY, FORCE, LOAD, TEMPERATURE, SERVO_POSITION, SERVO_VELOCITY,
    *OF_CHAMBERS,
)  # fmt: skip
"""Signals used by the diagnosis; the last two where the cylinder has two chambers."""

HELD = (COMMAND,)
"""Signals with zero-order hold between samples."""


class Record(NamedTuple):
    """Signals on a uniform time base.

    Attributes:
        name: name of the recording in messages.
        period: sampling period [s].
        time: sample times, shape (n,) [s].
        signals: values by name, finite everywhere, shape (n,).
        good: mask of the values that come from measured samples, by signal, shape (n,).
        noise: standard deviation of each signal's white noise, including its resolution.
        fresh: mask of the samples at which a continuous stretch begins.
        duration: time spanned by the recording, omitted parts included [s].
        remarks: remarks on the preparation, one sentence each.
        own: sampling periods of the signals slower than the time base [s].
        measured: measured signals that are commanded in experiments.
        not_judged: stages that cannot be judged from these data, with the reason.
    """

    name: str
    period: float
    time: Array
    signals: dict[str, Array]
    good: dict[str, Mask]
    noise: dict[str, float]
    fresh: Mask
    duration: float
    remarks: tuple[str, ...]
    own: Mapping[str, float] = {}
    measured: tuple[str, ...] = ()
    not_judged: Mapping[str, str] = {}

    def __contains__(self, signal: object) -> bool:
        """Return whether a signal was recorded."""
        return signal in self.signals

    def sampled(self, *signals: str) -> float:
        """Return the sampling period of the slowest of some signals, ignoring those not recorded [s]."""
        return max([self.period, *[self.own[signal] for signal in signals if signal in self.own and signal in self.signals]])

    def values(self, signal: str) -> Array:
        """Return a signal, or zeros if it was not recorded, shape (n,)."""
        return self.signals[signal] if signal in self.signals else np.zeros(len(self.time))

    @property
    def bounds(self) -> NDArray[np.intp]:
        """The first sample of each continuous stretch, and the number of samples, shape (stretches + 1,)."""
        return np.append(np.flatnonzero(self.fresh), len(self.time))

    def by_stretch(self, function: Callable[[Array], Array], values: Array) -> Array:
        """Return a function of each continuous stretch of a signal, none of which sees the samples beyond a pause."""
        return np.concatenate([function(part) for part in np.split(values, self.bounds[1:-1])])

    def parts(self, ranges: Sequence[tuple[int, int]]) -> "Record":
        """Return the record of some sample ranges, each as a separate stretch."""
        index = np.concatenate([np.arange(*r) for r in ranges])
        fresh = self.fresh[index]
        fresh[np.cumsum([0, *[end - begin for begin, end in ranges[:-1]]])] = True
        return self._replace(
            time=self.time[index],
            signals={name: values[index] for name, values in self.signals.items()},
            good={name: right[index] for name, right in self.good.items()},
            fresh=fresh,
        )


def prepare(trajectory: Trajectory, rig: Rig, name: str) -> Record:
    """Resample a recording to a uniform time base and mark the valid samples.

    Args:
        trajectory: the recording, any subset of :data:`USED`.
        rig: the rig, used to detect wrong units.
        name: name of the recording in errors.

    Returns:
        The record, without signals that have no finite sample.

    Raises:
        BadInput: time does not increase, too much of a signal is bad, or recording and rig contradict each other.
    """
    time = np.asarray(trajectory.time_s, dtype=np.float64)
    if len(time) < rules.MIN_SAMPLES:
        raise BadInput(f"there are {len(time)} samples", name, f"at least {rules.MIN_SAMPLES}")
    steps = np.diff(time)
    if not np.all(np.isfinite(time)) or np.any(steps <= 0.0):
        raise BadInput("time_s does not increase from sample to sample", name, "increasing times in seconds")
    period = float(np.median(steps))
    preparation = trajectory.preparation
    preparation.check_area(rig.plant.piston_area, name)
    chambers = rig.cylinder.law.CHAMBERS
    assumed = (EQUAL_AREAS_ASSUMED,) if chambers else ()
    remarks = [r for r in preparation.remarks if r not in assumed] + list(check_suits(trajectory, rig, name, fitted=True))
    chosen = _stretches(time, remarks)
    # Each sample belongs to the nearest grid point.
    apart = np.diff(time[chosen]) > max(PAUSE, PAUSE_STEPS * period)
    starts = np.flatnonzero(np.concatenate([[True], (np.diff(chosen) > 1) | apart]))
    pieces = np.split(chosen, starts[1:])
    grids = [time[p[0]] + period * np.arange(round((time[p[-1]] - time[p[0]]) / period) + 1) for p in pieces]
    grid = np.concatenate(grids)
    fresh = np.zeros(len(grid), dtype=np.bool_)
    fresh[np.cumsum([0, *[len(g) for g in grids[:-1]]])] = True
    signals, good, level = dict[str, Array](), dict[str, Mask](), dict[str, float]()
    lost = 1.0 - len(chosen) / len(grid)
    if lost > rules.MENTIONED:
        remarks.append(f"{100 * lost:.2g} % of the samples are missing")
    used = [signal for signal in USED if chambers or signal not in OF_CHAMBERS]
    recorded = {s: np.asarray(trajectory[s], dtype=np.float64)[chosen] for s in used if s in trajectory}
    if chambers and SUPPLY in recorded and TANK in trajectory:
        # On reading, the supply pressure was referred to the tank.
        recorded[SUPPLY] = recorded[SUPPLY] + np.asarray(trajectory[TANK], dtype=np.float64)[chosen]
    empty = [s for s, values in recorded.items() if not np.any(np.isfinite(values))]
    remarks += [f"{s} has no finite sample and is left out" for s in empty]
    recorded = {s: values for s, values in recorded.items() if s not in empty}
    trusted = {s: _not_spikes(values) if s in HELD else inliers(values) for s, values in recorded.items()}
    if COMMAND in recorded and SPOOL in recorded:
        trusted[COMMAND] |= _answered(recorded[COMMAND], np.where(trusted[SPOOL], recorded[SPOOL], np.nan), rig, period)
    for signal, values in recorded.items():
        right, slower = trusted[signal], preparation.interpolated.get(signal)
        bad = 1.0 - float(np.mean(right))
        if bad > rules.MAX_BAD:
            what = f"{100 * bad:.0f} % of signal '{signal}' are missing or outliers"
            raise BadInput(what, name, f"at most {100 * rules.MAX_BAD:.0f} %")
        if bad > rules.MENTIONED:
            remarks.append(f"{100 * bad:.2g} % of {signal} are missing or outliers and were left out")
        signals[signal], good[signal] = _on_grid(time[chosen], values, right, grid, period, signal in HELD)
        level[signal] = _noise(values[right], period) if slower is None else spread_noise(slower, period)
    own = {signal: own.period for signal, own in preparation.interpolated.items() if signal in signals}
    if chambers and has_both_chambers(signals):
        areas = {PRESSURE_A: rig.cylinder.parameters.area_a, PRESSURE_B: -rig.cylinder.parameters.area_b}
        weights = {signal: area / rig.plant.piston_area for signal, area in areas.items()}
        signals[PRESSURE] = sum((by * signals[signal] for signal, by in weights.items()), start=np.zeros(len(grid)))
        good[PRESSURE] = good[PRESSURE_A] & good[PRESSURE_B]
        level[PRESSURE] = math.hypot(*(by * level[signal] for signal, by in weights.items()))
        own |= {PRESSURE: max(own[signal] for signal in weights if signal in own)} if set(weights) & set(own) else {}
    within = np.diff(time[chosen])[~apart]
    if period > 0.0 and float(np.max(np.abs(within - period))) > rules.UNEVEN * period and lost <= rules.MENTIONED:
        remarks.append("the sampling is uneven; values are taken at even times by straight lines")
    return Record(
        name,
        period,
        grid,
        signals,
        good,
        level,
        fresh,
        duration=float(time[-1] - time[0]),
        remarks=tuple(remarks),
        own=own,
        measured=preparation.measured,
        not_judged={} if chambers else preparation.not_judged,
    )


def successive(recordings: Mapping[str, Trajectory]) -> Trajectory:
    """Return recordings of a rig in one condition as a single recording with pauses, so that they are judged together.

    Args:
        recordings: by their names in remarks and errors, each with at least two samples.

    Returns:
        The signals that all of them have, each recording as a separate stretch; remarks name the signals left out.

    Raises:
        BadInput: there is none, or their sampling periods, or the areas to which their load pressures refer, differ.
    """
    if not recordings:
        raise BadInput("there is no recording", "diagnosis", "at least one recording")
    if len(recordings) == 1:
        return next(iter(recordings.values()))
    periods = {name: float(np.median(np.diff(recording.time_s))) for name, recording in recordings.items()}
    first, period = next(iter(periods.items()))
    for name, own in periods.items():
        if abs(own - period) > SAME_PERIOD * period:
            what = f"it has a sample every {own:.4g} s, and {first} one every {period:.4g} s"
            raise BadInput(what, name, "recordings of one sampling rate, or a diagnosis of each")
    every = list(recordings.values())
    if len({recording.preparation.equivalent_area for recording in every}) > 1:
        raise BadInput("their load pressures refer to different areas", ", ".join(recordings), "recordings of one cylinder")
    common = [signal for signal in every[0].signals if all(signal in recording for recording in every)]
    partly = dict.fromkeys(signal for recording in every for signal in recording.signals if signal not in common)
    pause, begin, times = 2.0 * max(PAUSE, PAUSE_STEPS * period), 0.0, list[Array]()
    for recording in every:
        times.append(begin + recording.time_s - recording.time_s[0])
        begin = float(times[-1][-1]) + pause
    prepared = [recording.preparation for recording in every]
    return Trajectory(
        np.concatenate(times),
        {signal: np.concatenate([recording[signal] for recording in every]) for signal in common},
        preparation=prepared[0]._replace(
            remarks=(
                *(f"{name}: {remark}" for name, recording in recordings.items() for remark in recording.preparation.remarks),
                *(f"{signal} is not in all recordings and is left out" for signal in partly),
            ),
            interpolated={signal: own for p in prepared for signal, own in p.interpolated.items() if signal in common},
            measured=tuple(dict.fromkeys(signal for p in prepared for signal in p.measured)),
            not_judged={stage: why for p in prepared for stage, why in p.not_judged.items()},
        ),
    )


def spread_noise(own: Own, period: float) -> float:
    """Return the white-noise level on a faster clock with the power density of an interpolated signal's noise.

    Over windows of several original samples, both have the same effect on means, rates and curvatures.

    Args:
        own: original sampling of the signal.
        period: of the clock [s].
    """
    return own.noise * math.sqrt(own.period / period)


def _stretches(time: Array, remarks: list[str]) -> NDArray[np.intp]:
    duration = float(time[-1] - time[0])
    if duration <= MAX_RECORDING:
        return np.arange(len(time))
    length = MAX_RECORDING / STRETCHES
    begins = time[0] + np.linspace(0.0, duration - length, STRETCHES)
    remarks.append(f"of {duration:.0f} s, {STRETCHES} stretches of {length:.0f} s spread evenly over it are used")
    parts = [np.arange(*np.searchsorted(time, [b, b + length])) for b in begins]
    # A stretch in a gap of the recording may be empty; dropping the first sample keeps adjacent stretches apart.
    return np.unique(np.concatenate([p[1:] for p in parts if len(p) > 2]))


def _on_grid(time: Array, values: Array, right: Mask, grid: Array, period: float, held: bool) -> tuple[Array, Mask]:
    """Return a signal's values on the grid, and a mask of those that come from measured samples."""
    known, at = values[right], time[right]
    if held:
        index = np.clip(np.searchsorted(at, grid + rules.COMMAND_LATENESS * period, side="right") - 1, 0, len(at) - 1)
        out = known[index]
    else:
        out = np.interp(grid, at, known)
    after = np.clip(np.searchsorted(at, grid - 0.5 * period), 0, len(at) - 1)
    before = np.clip(after - 1, 0, len(at) - 1)
    near = np.minimum(np.abs(at[after] - grid), np.abs(at[before] - grid)) <= 0.5 * period
    inside = (at[after] - at[before] <= (rules.MAX_FILLED + 1.5) * period) & (grid >= at[0]) & (grid <= at[-1])
    return out, near | inside


def _not_spikes(values: Array) -> Mask:
    """Return the samples of a command that are finite and no lone spikes; a step is followed by more samples at its level."""
    whole = filled(values)
    before, after = np.concatenate([whole[:1], whole[:-1]]), np.concatenate([whole[1:], whole[-1:]])
    off = _stands_off(whole)
    alone = (whole - before) * (whole - after) > 0.0
    around = scipy.ndimage.median_filter(np.abs(whole - before), SPIKE_NEIGHBOURS, mode="nearest") + np.abs(after - before)
    jumps = (off > rules.SPIKE * around) & (off > MIN_SPIKE * np.max(np.abs(whole)))
    good: Mask = np.isfinite(values) & ~(alone & jumps)
    return good


def _stands_off(values: Array) -> Array:
    """Return the distance of each sample from the nearer of its two neighbours."""
    off: Array = np.minimum(np.abs(np.diff(values, prepend=values[:1])), np.abs(np.diff(values, append=values[-1:])))
    return off


def _answered(command: Array, spool: Array, rig: Rig, period: float) -> Mask:
    """Return the samples of a command to which the spool responds: these were sent, even if they look like spikes.

    A switching controller sends such lone samples.

    Args:
        command: the command [m], NaN where it is missing.
        spool: the spool's position [m], NaN where it is missing or an outlier.
        rig: the valve's gain and bandwidth.
        period: sampling period [s].
    """
    spool = filled(spool)
    moves = np.diff(spool, prepend=spool[:1])
    turns = np.abs(np.diff(moves, prepend=moves[:1]))
    window = max(3, round(rules.ANSWERED_WITHIN / period))
    # The strongest response in the window that begins at each sample.
    strongest = scipy.ndimage.maximum_filter1d(turns, window, origin=-(window // 2), mode="nearest")
    follows = abs(rig.plant.valve_gain) * (1.0 - math.exp(-rig.plant.valve_bandwidth * period))
    answered: Mask = np.isfinite(command) & (strongest > rules.ANSWERED * follows * _stands_off(filled(command)))
    return answered


def _noise(values: Array, period: float) -> float:
    """Return the standard deviation of a signal's noise, or of its quantisation if that is larger."""
    moves = np.abs(np.diff(values[: min(len(values), RESOLUTION_SAMPLES)]))
    moves = moves[moves > 1e-12 * max(float(np.max(np.abs(values))), 1e-300)]
    lattice = float(np.min(moves)) if moves.size else 0.0
    # All differences must be multiples of a resolution.
    if lattice > 0.0 and np.max(np.abs(moves / lattice - np.round(moves / lattice))) > RESOLUTION_MISFIT:
        lattice = 0.0
    found = noise_between_moves if period > rules.SLOWEST_TURN else noise
    return max(found(values), lattice / math.sqrt(12.0))
