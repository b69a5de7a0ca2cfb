"""What the sampling of a recording resolves: judged by how far things move within a sample, not by a fixed rate."""

import math
from collections.abc import Collection

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.record import COMMAND, HELD, POSITION, SPOOL, VELOCITY, Record
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask


def command_seen(record: Record, rig: Rig) -> bool:
    """Tell whether no command was missed between two samples: they are close for the valve, or the command is slow itself.

    Args:
        record: the recording, with a command.
        rig: the rig, for the valve's bandwidth.
    """
    period = record.sampled(COMMAND, SPOOL)
    if period * rig.plant.valve_bandwidth <= rules.SLOWEST:
        return True
    stride = max(1, round(period / record.period))
    values = record.signals[COMMAND][::stride]
    return float(np.sqrt(np.mean(np.diff(values) ** 2))) <= rules.SLOWEST * float(np.std(values))


def presliding_travel(rig: Rig) -> float:
    """Return the travel from rest after which all of the contact slips [m]; 0 for a model whose friction jumps."""
    effective = rig.effective()
    return float(effective.friction_law.break_away(effective.friction))


def friction_known(record: Record, position: Array, velocity: Array, travel: float, noise: float) -> Mask:
    """Tell where friction follows from the recorded motion although samples are slow.

    A turn is resolved if the piston covers little of the presliding travel within the sample in which it turns. After any other
    turn, friction is that of sliding again once the piston has left the place by several times that travel.

    Args:
        record: the recording.
        position: of the piston, smoothed, shape (n,) [m].
        velocity: of the piston, smoothed, shape (n,) [m/s].
        travel: presliding travel [m].
        noise: standard deviation of the velocity's noise [m/s]; at rest it looks like turns, which the noise floor holds.

    Returns:
        A mask of shape (n,).
    """
    known = np.ones(len(position), dtype=np.bool_)
    period = record.sampled(POSITION, VELOCITY)
    stride = max(1, round(period / record.period))
    coarse = velocity[::stride]
    turns = np.flatnonzero(coarse[1:] * coarse[:-1] < 0.0)
    change = np.abs(coarse[turns + 1] - coarse[turns])
    unresolved = (0.5 * change * period > rules.TURN_SEEN * travel) & (change > rules.CLEAR_TURN * noise)
    for turn in turns[unresolved] * stride:
        end = min(turn + stride, len(position) - 1)
        away = np.abs(position[end:] - position[turn]) >= rules.SLIDING * travel
        first = int(np.argmax(away)) if np.any(away) else len(away)
        known[max(turn - stride, 0) : end + max(first, stride)] = False
    return known


def coarseness(record: Record, signals: Collection[str]) -> Array:
    """Return by how much straight lines between samples are worse than at a rate that resolves everything.

    They are off where a signal bends from one of its own samples to the next.

    Args:
        record: the recording.
        signals: those of it that matter; a held command has no lines.

    Returns:
        The factor at each sample, 1 or more, shape (n,).
    """
    bent = [_bends(record, signal) for signal in signals if signal not in HELD]
    worse: Array = np.max([np.ones(len(record.time)), *bent], axis=0)
    return worse


def _bends(record: Record, signal: str) -> Array:
    period, values = record.sampled(signal), record.signals[signal]
    stride, size = max(1, round(period / record.period)), float(np.sqrt(np.mean(values**2)))
    if period <= rules.UNSEEN_COMMANDS * rules.RESOLVED_PERIOD or size == 0.0:
        return np.ones(len(values))
    longer = np.pad(values, stride, mode="reflect", reflect_type="odd")
    bend = np.abs(longer[2 * stride :] - 2.0 * values + longer[: -2 * stride])
    # The second difference of white noise has six times its variance.
    noise = math.sqrt(6.0 * record.period / period) * record.noise[signal]
    bend = np.where(bend > rules.CLEAR_BEND * noise, np.sqrt(np.maximum(bend**2 - noise**2, 0.0)), 0.0)
    worst: Array = scipy.ndimage.maximum_filter1d(bend, 2 * stride + 1, mode="nearest") / (8.0 * size * rules.TOLERANCE)
    return worst
