"""Prediction of a recording's signals from its command: free runs over windows that start from the measured past.

The initial state of a window is taken from the samples before it. Within the window, only the command and the disturbance are
taken from the recording. So errors add up over the window's length, not over the recording's as in
:mod:`ehls_ros.diagnosis.free_run`.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.free_run import balance_friction, follow, set_pressures, simulated_columns
from ehls_ros.diagnosis.record import COMMAND, FORCE, POSITION, PRESSURE, SPOOL, SUPPLY, TEMPERATURE, VELOCITY, Record, prepare
from ehls_ros.diagnosis.stages import Comparison, setup
from ehls_ros.errors import BadInput
from ehls_ros.physics.plant import XV, V, X, hold
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.simulator import Simulator, earlier_commands
from ehls_ros.samples import Mask
from ehls_ros.trajectory import Trajectory, has_both_chambers

PAST = 0.02
"""Time before a window of a prediction from which its initial state is taken [s]."""

FEWEST_PAST = 8
"""Fewest samples from which that state is taken."""

STARTS_A_WINDOW = 4
"""Number of windows of a prediction that start within the length of the shortest."""

UNCHANGED = "value kept"
"""Name of the trivial prediction: each signal keeps its value at the start of the window."""


class Windows(NamedTuple):
    """Predictions over windows of one length.

    Attributes:
        length: of the windows [s].
        starts: their starts since the recording's start, shape (n,) [s].
        errors: by signal and model, the rms error in each window as a fraction of the signal's standard deviation over all
            windows, shape (n,); NaN where the simulated piston left the stroke.
    """

    length: float
    starts: Array
    errors: Mapping[str, Mapping[str, Array]]


class Prediction(NamedTuple):
    """Predictions of a recording.

    Attributes:
        windows: by length, shortest first.
        remarks: sentences about the data.
    """

    windows: tuple[Windows, ...]
    remarks: tuple[str, ...]


def nrmse(errors: Array) -> float | None:
    """Return the rms error over all windows as a fraction of the signal's standard deviation; None if one has no error."""
    found = math.sqrt(float(np.mean(errors**2)))
    return found if math.isfinite(found) else None


def predict(
    trajectory: Trajectory,
    rigs: Mapping[str, Rig],
    lengths: Sequence[float],
    name: str = "recording",
    begin: float = 0.0,
    end: float = math.inf,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Prediction:
    """Predict the signals of a recording from its command.

    Windows of all lengths overlap: they start at intervals of a quarter of the shortest length.

    Args:
        trajectory: the recording, with command, position, and load pressure or force.
        rigs: the models, by name.
        lengths: lengths of the windows [s].
        name: name of the recording in errors.
        begin: start of the time to predict, since the recording's start [s].
        end: its end [s].
        progress: called with the number of windows simulated and their total.

    Raises:
        BadInput: a required signal is missing, or there is no window of a length.
    """
    record = prepare(trajectory, next(iter(rigs.values())), name)
    columns = simulated_columns(record, name, TEMPERATURE, SUPPLY)
    wanted = sorted(set(lengths))
    counts = [max(1, round(length / record.period)) for length in wanted]
    starts = _starts(record, max(1, counts[0] // STARTS_A_WINDOW), begin)
    ends = _ends(record, starts, end)
    missing = np.cumsum(_missing(record), dtype=np.intp)
    inside = [(starts + count <= ends) & _whole(missing, starts - _past(record), starts + count) for count in counts]
    for length, some in zip(wanted, inside, strict=True):
        if not np.any(some):
            raise BadInput(f"there is no window of {length:g} s", name, "a longer time without gaps, or shorter windows")
    used = inside[0]
    starts, ends = starts[used], np.minimum(ends[used], starts[used] + counts[-1])
    total = len(rigs) * len(starts)
    readings: dict[str, list[Array]] = {called: [] for called in rigs}
    for called, rig in rigs.items():
        for run in _runs(record, rig, starts, ends):
            readings[called].append(run)
            progress(sum(map(len, readings.values())), total)
    found = []
    for length, count, some in zip(wanted, counts, inside, strict=True):
        chosen = np.flatnonzero(some[used])
        errors: dict[str, dict[str, Array]] = {}
        for signal, column in columns.items():
            models = {called: [runs[i][:count, column] for i in chosen] for called, runs in readings.items()}
            models[UNCHANGED] = [np.full(count, record.signals[signal][starts[i]]) for i in chosen]
            errors[signal] = {called: _errors(record, signal, starts[chosen], runs) for called, runs in models.items()}
        found.append(Windows(length, record.time[starts[chosen]] - record.time[0], errors))
    return Prediction(tuple(found), record.remarks)


def _past(record: Record) -> int:
    """Return the number of samples before a window from which its initial state is taken."""
    return max(FEWEST_PAST, round(PAST / record.period))


def _starts(record: Record, apart: int, begin: float) -> NDArray[np.intp]:
    """Return the last measured sample before each window, ``apart`` samples from each other within each stretch."""
    first = int(np.searchsorted(record.time - record.time[0], begin))
    each = [np.arange(max(low + _past(record), first), high, apart) for low, high in pairwise(record.bounds.tolist())]
    return np.concatenate(each)


def _ends(record: Record, starts: NDArray[np.intp], end: float) -> NDArray[np.intp]:
    """Return the last sample that a window from each start may contain."""
    stretch = record.bounds[np.searchsorted(record.bounds, starts, side="right")] - 1
    latest = int(np.searchsorted(record.time - record.time[0], end, side="right")) - 1
    return np.minimum(stretch, latest)


def _missing(record: Record) -> Mask:
    """Return the samples in gaps of the signals that drive and start a window; a lone outlier is no gap."""
    out = np.zeros(len(record.time), dtype=np.bool_)
    for signal in (COMMAND, POSITION, PRESSURE if PRESSURE in record else FORCE):
        bad = ~record.good[signal]
        out[1:] |= bad[1:] & bad[:-1]
    return out


def _whole(missing: NDArray[np.intp], begins: NDArray[np.intp], ends: NDArray[np.intp]) -> Mask:
    """Return the ranges of samples without a missing one, from the number of missing samples so far."""
    last = len(missing) - 1
    return missing[np.minimum(ends, last)] == missing[np.clip(begins, 0, last)]


def _errors(record: Record, signal: str, starts: NDArray[np.intp], predicted: Sequence[Array]) -> Array:
    """Return the rms error in each window, as a fraction of the signal's standard deviation over all windows."""
    measured, good = record.signals[signal], record.good[signal]
    covered = np.zeros(len(measured), dtype=np.bool_)
    out = np.zeros(len(starts))
    for i, (start, values) in enumerate(zip(starts.tolist(), predicted, strict=True)):
        window = slice(start + 1, start + 1 + len(values))
        known = good[window]
        covered[window] |= known
        out[i] = math.sqrt(float(np.mean((values - measured[window])[known] ** 2))) if np.any(known) else 0.0
    return out / float(np.std(measured[covered]))


def _runs(record: Record, rig: Rig, starts: NDArray[np.intp], ends: NDArray[np.intp]) -> Iterator[Array]:
    """Yield the readings of each window's free run, NaN where it left the stroke, shape (samples, signals)."""
    comparison, effective = Comparison(record, setup(record, rig)), rig.effective()
    spool = comparison.corrected(effective, "spool_position") if SPOOL in record else comparison.simulated_spool(effective)
    position, pressure = comparison.corrected(effective, "position"), comparison.pressure(effective)
    both = comparison.chamber_pressures(effective) if has_both_chambers(record.signals) else None
    supply = comparison.corrected(effective, "supply_pressure") if SUPPLY in record else None
    past, history, command = _past(record), earlier_commands(effective, record.period), record.values(COMMAND)
    latest = record.period * np.arange(1 - past, 1)
    # A parabola through the past samples removes noise and keeps the motion.
    row = np.linalg.pinv(np.vander(latest, 3, increasing=True))
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        simulator = Simulator(rig.quiet(), record.period)
        for k in range(max(start - history, 0), start):
            hold(simulator.inputs, 0.0, command[k], 0.0, 0.0, 0.0, 0.0)
        before = slice(start + 1 - past, start + 1)
        simulator.y[X], simulator.y[V] = row[:2] @ position[before]
        if VELOCITY in record:
            simulator.y[V] = row[0] @ comparison.corrected(effective, "velocity")[before]
        chambers = None if both is None else (row[0] @ both[0][before], row[0] @ both[1][before])
        set_pressures(simulator, row[0] @ pressure[before], chambers, None if supply is None else row[0] @ supply[before])
        simulator.y[XV] = spool[start]
        balance_friction(simulator, record, start)
        yield follow(simulator, record, start, end + 1)[1:]
