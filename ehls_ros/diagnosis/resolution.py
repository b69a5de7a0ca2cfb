"""Time resolution of a recording, judged by the motion within a sample instead of a fixed sampling rate."""

import math
from collections.abc import Collection

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.loss import rms
from ehls_ros.diagnosis.record import COMMAND, HELD, POSITION, SPOOL, VELOCITY, Record
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask


def command_seen(record: Record, rig: Rig) -> bool:
    """Return whether no command was missed between samples: the sampling is fast for the valve, or the command is slow.

    Args:
        record: the recording, with a command.
        rig: the rig, for the valve's bandwidth.
    """
    period = record.sampled(COMMAND, SPOOL)
    if period * rig.plant.valve_bandwidth <= rules.SLOWEST:
        return True
    stride = max(1, round(period / record.period))
    values = record.signals[COMMAND][::stride]
    return rms(np.diff(values)) <= rules.SLOWEST * float(np.std(values))


def presliding_travel(rig: Rig) -> float:
    """Return the travel from rest to full slip of the contact [m]; 0 for a model without presliding."""
    effective = rig.effective()
    return float(effective.friction_law.break_away(effective.friction))


def friction_known(record: Record, position: Array, velocity: Array, travel: float, noise: float) -> Mask:
    """Return the samples at which friction follows from the recorded motion despite slow sampling.

    A reversal is resolved if the piston covers little of the presliding travel within the sample of the reversal. After any
    other reversal, friction is that of sliding again once the piston has moved away by several times that travel.

    Args:
        record: the recording.
        position: of the piston, smoothed, shape (n,) [m].
        velocity: of the piston, smoothed, shape (n,) [m/s].
        travel: presliding travel [m].
        noise: standard deviation of the velocity's noise [m/s]; at rest it looks like reversals, covered by the noise floor.

    Returns:
        A mask of shape (n,).
    """
    known = np.ones(len(position), dtype=np.bool_)
    period = record.sampled(POSITION, VELOCITY)
    stride = max(1, round(period / record.period))
    coarse = velocity[::stride]
    turns = np.flatnonzero(coarse[1:] * coarse[:-1] < 0.0)
    change = np.abs(coarse[turns + 1] - coarse[turns])
    unresolved = (0.5 * change * period > rules.TURN_SEEN * travel) & (change > rules.NOISE_MARGIN * noise)
    for turn in turns[unresolved] * stride:
        end = min(turn + stride, len(position) - 1)
        away = np.abs(position[end:] - position[turn]) >= rules.SLIDING * travel
        first = int(np.argmax(away)) if np.any(away) else len(away)
        known[max(turn - stride, 0) : end + max(first, stride)] = False
    return known


def coarseness(record: Record, signals: Collection[str]) -> Array:
    """Return the factor by which the error of linear interpolation exceeds that at a fully resolving sampling rate.

    The error arises from the curvature of a signal between its original samples.

    Args:
        record: the recording.
        signals: the relevant signals; a held command is not interpolated.

    Returns:
        The factor at each sample, 1 or more, shape (n,).
    """
    bent = [_bends(record, signal) for signal in signals if signal not in HELD]
    worse: Array = np.max([np.ones(len(record.time)), *bent], axis=0)
    return worse


def _bends(record: Record, signal: str) -> Array:
    period, values = record.sampled(signal), record.signals[signal]
    stride, size = max(1, round(period / record.period)), rms(values)
    if period <= rules.UNSEEN_PERIOD or size == 0.0:
        return np.ones(len(values))
    longer = np.pad(values, stride, mode="reflect", reflect_type="odd")
    bend = np.abs(longer[2 * stride :] - 2.0 * values + longer[: -2 * stride])
    # The second difference of white noise has six times its variance.
    noise = math.sqrt(6.0 * record.period / period) * record.noise[signal]
    bend = np.where(bend > rules.MAX_ALLOWED * noise, np.sqrt(np.maximum(bend**2 - noise**2, 0.0)), 0.0)
    worst: Array = scipy.ndimage.maximum_filter1d(bend, 2 * stride + 1, mode="nearest") / (8.0 * size * rules.TOLERANCE)
    return worst
