"""Preparation of a recording for identification: uniform blocks of position, force, and the position's derivatives.

Identification needs position and driving force. Velocity and acceleration are derivatives of a local cubic fit of the
position, because a rig has no sensors for them.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import GAUSS, Mask, inliers, noise
from ehls_ros.trajectory import Trajectory

BLOCK_LENGTHS, BLOCKS = (0.005, 0.01, 0.02, 0.05, 0.1), 100_000
"""Lengths of a block [s], and the maximum number of blocks of all recordings, as far as the longest length allows."""

BRANCH_BLOCKS, LONGEST_FINE = 80, 0.02
"""Blocks between two reversals that resolve the hysteresis loop, and the longest such block [s]."""

SLOW, CLEAR = 0.1, 0.01
"""Quantile of the speeds that counts as slow, and noise of a block's velocity as a fraction of it below which it is clear."""

LAST_FRACTION, MIN_SETTLED = 0.4, 0.85
"""Fraction at the end of a short stroke that is used, and fraction of the settling time that must have passed by then."""

WINDOW = 9
"""Number of blocks in the window of a local fit."""

SMALL_TRAVEL = 0.02
"""Travel below which a recording is one of presliding, divided into short blocks [m]."""

ORDER = 3
"""Order of the local polynomial."""

MAX_OUTLIERS = 0.25
"""Largest fraction of outliers in a signal; with more, the valid samples cannot be determined."""

STUCK_TIME, STUCK_TRAVEL = 1.0, 1e-3
"""Time [s] and travel [m] over which an exactly constant force indicates a stuck sensor."""

TURN_DOUBT = 4.0
"""Standard deviations of a position sample by which a turning point may be missed; smaller oscillation is invisible."""

STUCK_FORCE = 2.5
"""Change of force, in units of static friction, that no piston withstands at rest; 2 spans both limits."""

FULL_BLOCK = 0.5
"""Least fraction of a block's samples that must be present."""

SMALLEST_MISFIT = 1e-5
"""Misfit of the local fit that is always accepted, as a fraction of the travel."""


class Motion(NamedTuple):
    """One recording in blocks, shape (n,) each.

    Attributes:
        name: name of the recording in messages.
        period: time between blocks [s].
        time: middle of each block [s].
        position: mean position, smoothed [m].
        velocity: its derivative [m/s].
        acceleration: its second derivative [m/s^2].
        force: mean driving force, outliers left out [N].
        scatter: standard deviation of the force's samples within each block, about a straight line [N].
        fresh: whether a block begins a stretch without gaps.
        resolved: whether position and derivatives are valid: no gap, and no motion too fast for the local fit.
        force_noise: standard deviation of a block's mean force from the sensor's noise [N].
        velocity_noise: standard deviation of the velocity from the sensor's noise [m/s].
        turn_doubt: distance by which a turning point may lie beyond its measured position because of sensor noise [m].
        outliers: fraction of the samples that were left out.
    """

    name: str
    period: float
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    force: Array
    scatter: Array
    fresh: Mask
    resolved: Mask
    force_noise: float
    velocity_noise: float
    turn_doubt: float
    outliers: float

    @property
    def small(self) -> bool:
        """Whether the recording is one of presliding, with a travel below :data:`SMALL_TRAVEL`."""
        return bool(np.any(self.resolved)) and float(np.ptp(self.position[self.resolved])) < SMALL_TRAVEL

    @property
    def turns(self) -> NDArray[np.intp]:
        """Indices of the blocks whose direction differs from the previous block's."""
        return np.flatnonzero(np.diff(np.sign(self.velocity)) != 0.0) + 1

    @property
    def strokes(self) -> NDArray[np.intp]:
        """Number of each block's stroke, from 0: a motion in one direction without a gap, shape (n,)."""
        begins = self.fresh.copy()
        begins[self.turns] = True
        begins[0] = False
        return np.cumsum(begins)


def motions_of(recordings: Mapping[str, Trajectory], rig: Rig) -> tuple[Motion, ...]:
    """Divide recordings into blocks, short ones for presliding and longer ones for wide strokes.

    Args:
        recordings: by a name for errors.
        rig: as in :func:`prepare`.

    Raises:
        BadInput: as in :func:`prepare`.
    """
    total = sum(float(t.time_s[-1] - t.time_s[0]) for t in recordings.values() if len(t) > 1)
    shortest = min(total / BLOCKS, BLOCK_LENGTHS[-1])
    return tuple(prepare(t, rig, name, block_length(t, shortest)) for name, t in recordings.items())


def _travel(trajectory: Trajectory) -> float:
    """Return the range of the position without stray samples [m]."""
    position = trajectory.signals.get("position_m", np.zeros(1))
    position = position[np.isfinite(position)]
    return float(np.ptp(np.quantile(position, [0.01, 0.99]))) if position.size else 0.0


def block_length(trajectory: Trajectory, shortest: float) -> float:
    """Return the shortest block in which the velocity is clear of the position's noise [s].

    Args:
        trajectory: the recording.
        shortest: lower limit for wide strokes [s].
    """
    position = trajectory.signals.get("position_m", np.zeros(0))
    position = position[np.isfinite(position)]
    if len(position) < 100:
        return BLOCK_LENGTHS[0]
    sample = float(np.median(np.diff(trajectory.time_s)))
    stride = max(1, round(BLOCK_LENGTHS[-1] / sample))
    speed = np.abs(np.diff(position[::stride])) / (stride * sample)
    if _travel(trajectory) < SMALL_TRAVEL:
        passes = np.count_nonzero(np.diff(position[::stride] > np.median(position)))
        branch = (trajectory.time_s[-1] - trajectory.time_s[0]) / max(1, passes)
        fine = [length for length in BLOCK_LENGTHS if branch >= BRANCH_BLOCKS * length and length <= LONGEST_FINE]
        return max(fine[-1] if fine else BLOCK_LENGTHS[0], sample)
    moving = speed[speed > 0.1 * np.median(speed)]
    slow = float(np.quantile(moving, SLOW)) if moving.size else 0.0
    per_sample = noise(position)
    for length in BLOCK_LENGTHS:
        block = max(length, sample)
        if length >= shortest and slope_noise(per_sample / np.sqrt(block / sample), block) < CLEAR * slow:
            return block
    return max(BLOCK_LENGTHS[-1], sample)


def prepare(trajectory: Trajectory, rig: Rig, name: str, period: float) -> Motion:
    """Divide a recording into uniform blocks.

    Args:
        trajectory: the recording; needs ``position_m``, and ``force_n`` or ``load_pressure_pa``.
        rig: the rig, for the piston area.
        name: name of the recording in errors.
        period: length of a block [s].

    Returns:
        The motion.

    Raises:
        BadInput: a signal is missing, constant, stuck or has too many outliers, the recording is too short, or its load
            pressure refers to another piston area.
    """
    trajectory.preparation.check_area(rig.plant.piston_area, name)
    position = _signal(trajectory, "position_m", name)
    if "force_n" in trajectory and np.any(np.isfinite(trajectory["force_n"])):
        source, force = "force_n", trajectory["force_n"]
    elif "load_pressure_pa" in trajectory:
        source, force = "load_pressure_pa", rig.plant.piston_area * trajectory["load_pressure_pa"]
    else:
        raise BadInput("signal 'force_n' is missing", name, "force_n, or load_pressure_pa from which it follows")
    time = trajectory.time_s - trajectory.time_s[0]
    if len(time) < 2 * WINDOW or time[-1] < 2 * WINDOW * period:
        raise BadInput(f"it is {time[-1]:.3g} s long with {len(time)} samples", name, f"at least {2 * WINDOW * period:g} s")
    good_position, good_force = _inliers(position, "position_m", name), _inliers(force, source, name)
    _check_moves(position[good_position], force[good_force], source, name)
    _check_stuck(time, position, force, source, rig, name)

    blocks = int(time[-1] // period)
    x, x_time, count_x = _means(time, position, good_position, period, blocks)
    f, f_time, count_f = _means(time, force, good_force, period, blocks)
    expected = period / float(np.median(np.diff(time)))
    there = (count_x >= FULL_BLOCK * expected) & (count_f >= FULL_BLOCK * expected)
    middle = (np.arange(blocks, dtype=np.float64) + 0.5) * period
    _, velocity, _, _ = _local_fit(x, there, period)
    # The mean time of a block with missing samples is not its middle.
    x = x + velocity * (middle - x_time)
    smooth, velocity, acceleration, inside = _local_fit(x, there, period)
    slope = np.gradient(np.where(there, f, np.interp(middle, middle[there], f[there])), period)
    squares, *_ = _means(time, (force - np.mean(force[good_force])) ** 2, good_force, period, blocks)
    variance = squares - (f - np.mean(force[good_force])) ** 2 - (slope * period) ** 2 / 12.0
    f = f + slope * (middle - f_time)

    per_block = max(1.0, expected)
    position_noise = noise(position[good_position]) / np.sqrt(per_block)
    force_noise = noise(force[good_force]) / np.sqrt(per_block)
    misfit = np.abs(x - smooth)
    least = SMALLEST_MISFIT * float(np.ptp(smooth[inside])) if np.any(inside) else 0.0
    usual = max(GAUSS * float(np.median(misfit[inside])) if np.any(inside) else 0.0, position_noise, least)
    resolved = inside & ~_widened(misfit > 5.0 * usual, WINDOW // 2)
    # Plain differences preserve the total deflection of the contact, which the local fit smooths.
    filled = np.interp(middle, middle[there], x[there])
    velocity = np.where(resolved, velocity, np.gradient(filled, period))
    fresh = there & ~np.concatenate([[False], there[:-1]])
    return Motion(
        name=name,
        period=period,
        time=middle,
        position=smooth,
        velocity=velocity,
        acceleration=acceleration,
        force=f,
        scatter=np.sqrt(np.maximum(np.nan_to_num(variance), 0.0)),
        fresh=fresh,
        resolved=resolved,
        force_noise=force_noise,
        velocity_noise=slope_noise(position_noise, period),
        turn_doubt=TURN_DOUBT * noise(position[good_position]),
        outliers=1.0 - float(np.mean(good_position & good_force)),
    )


def _signal(trajectory: Trajectory, signal: str, name: str) -> Array:
    if signal not in trajectory:
        raise BadInput(f"signal '{signal}' is missing", name, f"a recording with {signal}")
    values = trajectory[signal]
    if not np.any(np.isfinite(values)):
        raise BadInput(f"signal '{signal}' has no finite sample", name, f"a recording with {signal}")
    return values


def _inliers(values: Array, signal: str, name: str) -> Mask:
    """Return the samples that are finite and consistent with their neighbours."""
    finite, good = np.isfinite(values), inliers(values)
    if np.mean(finite) > 0.0 and np.mean(good[finite]) < 1.0 - MAX_OUTLIERS:
        raise BadInput(
            f"{100 * np.mean(~good):.0f} % of signal '{signal}' are outliers", name, f"at most {100 * MAX_OUTLIERS:.0f} %"
        )
    return good


def _check_moves(position: Array, force: Array, source: str, name: str) -> None:
    """Reject a recording with constant position or force."""
    if float(np.ptp(position)) <= 0.0:
        raise BadInput("position_m does not change", name, "a recording in which the piston moves")
    if float(np.ptp(force)) <= 0.0:
        raise BadInput(f"{source} does not change", name, "a force sensor that is not stuck")


def _check_stuck(time: Array, position: Array, force: Array, source: str, rig: Rig, name: str) -> None:
    """Reject a signal that stays exactly constant while the other shows motion."""
    start, end = _longest_constant(force)
    if time[end] - time[start] > STUCK_TIME and abs(position[end] - position[start]) > STUCK_TRAVEL:
        what = f"{source} is stuck from {time[start]:.3g} to {time[end]:.3g} s while the piston moves"
        raise BadInput(what, name, "a force sensor that is not stuck; cut that stretch off")
    start, end = _longest_constant(position)
    holds = STUCK_FORCE * rig.friction_level(0.0)
    if time[end] - time[start] > STUCK_TIME and np.ptp(force[start : end + 1]) > holds:
        what = f"position_m is stuck from {time[start]:.3g} to {time[end]:.3g} s while the force changes"
        raise BadInput(what, name, "a position sensor that is not stuck; cut that stretch off")


def _longest_constant(values: Array) -> tuple[int, int]:
    changes = np.flatnonzero(np.diff(values) != 0.0)
    edges = np.concatenate([[-1], changes, [len(values) - 1]])
    longest = int(np.argmax(np.diff(edges)))
    return int(edges[longest]) + 1, int(edges[longest + 1])


def _means(time: Array, values: Array, good: Mask, period: float, blocks: int) -> tuple[Array, Array, Array]:
    """Return mean, mean time and number of the good samples of each block; NaN if there are none."""
    # A sample on the boundary of two blocks belongs to the later one, despite rounding.
    index = np.minimum((time[good] / period + 1e-6).astype(np.intp), blocks)
    count = np.bincount(index, minlength=blocks + 1)[:blocks].astype(np.float64)
    total = np.bincount(index, weights=values[good], minlength=blocks + 1)[:blocks]
    moment = np.bincount(index, weights=time[good], minlength=blocks + 1)[:blocks]
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / count, moment / count, count


def _local_fit(x: Array, there: Mask, period: float) -> tuple[Array, Array, Array, Mask]:
    """Return smoothed position, velocity, acceleration, and a mask of the blocks whose window lies within one stretch."""
    filled = np.interp(np.arange(len(x)), np.flatnonzero(there), x[there]) if np.any(there) else np.zeros(len(x))
    rows = [scipy.signal.savgol_coeffs(WINDOW, ORDER, deriv=d, delta=period, use="dot") for d in range(3)]
    half = WINDOW // 2
    padded = np.pad(filled, half, mode="edge")
    smooth, velocity, acceleration = (np.convolve(padded, row[::-1], mode="valid") for row in rows)
    inside = ~_widened(~there, half)
    inside[:half] = inside[-half:] = False
    return smooth, velocity, acceleration, inside


def _widened(mask: Mask, by: int) -> Mask:
    wide: Mask = np.convolve(mask, np.ones(2 * by + 1), mode="same") > 0.5
    return wide


def slope_noise(block_noise: float, period: float) -> float:
    """Return the noise of the velocity [m/s] from that of a block's mean position [m]."""
    return block_noise * float(np.sqrt(np.sum(scipy.signal.savgol_coeffs(WINDOW, ORDER, deriv=1, delta=period) ** 2)))


def slides(motion: Motion, travel: float, time: float) -> Mask:
    """Return the blocks that slide, far enough from the last reversal for the friction to be independent of it.

    Long blocks blur a reversal; its friction is identified from recordings of presliding.

    Args:
        motion: a recording of wide strokes.
        travel: required travel since the reversal [m].
        time: required time since the reversal [s].

    Returns:
        A mask of shape (n,).
    """
    stroke = motion.strokes
    start = np.searchsorted(stroke, stroke)
    time_since = (np.arange(len(stroke)) - start) * motion.period
    travel_since = np.abs(motion.position - motion.position[start])
    lasts = np.bincount(stroke) * motion.period
    # The end of a stroke shorter than that time is used too, unless it is still settling.
    needed = np.clip((1.0 - LAST_FRACTION) * lasts, MIN_SETTLED * time, time)[stroke]
    moves = np.abs(motion.velocity) > 5.0 * motion.velocity_noise
    sliding: Mask = moves & (travel_since >= travel) & (time_since >= needed)
    return sliding
