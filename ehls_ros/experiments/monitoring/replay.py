"""Replay of recordings through the monitor, as in `ehls monitor`, without files."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.contradictions import check_suits
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, PastReadings, Reading
from ehls_ros.diagnosis.record import USED
from ehls_ros.experiments.compiling import COMPILING, compile_in_parallel, diagnosis_jobs, identification_jobs
from ehls_ros.experiments.monitoring.examination import SynchronousExaminer
from ehls_ros.experiments.monitoring.health import Event, FoundChange, Health
from ehls_ros.experiments.monitoring.monitor import Monitor, Parameters
from ehls_ros.experiments.monitoring.offer import Offer, offer
from ehls_ros.experiments.monitoring.trends import LimitPrediction, predict_limits
from ehls_ros.identification.rig_coefficients import OF_ONE_PRESSURE
from ehls_ros.parallel import Workers
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import Rig
from ehls_ros.progress import Update
from ehls_ros.samples import Mask
from ehls_ros.trajectory import Trajectory

CHUNK = 0.25
"""Duration of the samples passed to the monitor at once [s]."""

RECORDING_GAP = 1.0
"""Time on the monitor's axis between two recordings [s]; the true time is unknown."""


class MonitoredRecording(NamedTuple):
    """A recording to be watched.

    Attributes:
        name: name of the recording.
        trajectory: the recording.
        pauses: first and last time of each stretch in which no command reached the valve, on its time base [s].
    """

    name: str
    trajectory: Trajectory
    pauses: Sequence[tuple[float, float]] = ()


class RecordingSpan(NamedTuple):
    """Position of a recording on the monitor's axis.

    Attributes:
        name: name of the recording.
        begin, end: its first and last time [s].
        not_driven: time not judged because no command reached the valve [s].
    """

    name: str
    begin: float
    end: float
    not_driven: float


class MonitoringResult(NamedTuple):
    """Results of monitoring a rig over a time, for file and page.

    Attributes:
        rig: the healthy rig: as described in its file, or as identified if numbers of the file are wrong.
        parameters: monitoring parameters.
        health: health at the end.
        history: the coefficients over time.
        events: events in order.
        stretches: recordings on the time axis; none for a running rig.
        limits: predicted times to the limits of coefficients that have one.
        missing: names of the coefficients that this programme does not determine.
        offer: shortest experiment that determines most of them; None if none does.
    """

    rig: Rig
    parameters: Parameters
    health: Health
    history: Sequence[PastReadings]
    events: Sequence[Event]
    stretches: Sequence[RecordingSpan] = ()
    limits: Mapping[str, LimitPrediction] = {}
    missing: tuple[str, ...] = ()
    offer: Offer | None = None


def replay(
    parts: Sequence[MonitoredRecording],
    rig: Rig,
    parameters: Parameters,
    *,
    baselines: Mapping[str, Trajectory],
    limits: Mapping[str, float],
    progress: Update,
    on_event: Callable[[Event], None],
) -> MonitoringResult:
    """Monitor recordings one after another, each as a separate stretch.

    Args:
        parts: the recordings, oldest first.
        rig: the rig as described in its file.
        parameters: monitoring parameters.
        baselines: recordings of the healthy rig, by name; none: the first samples are used for learning.
        limits: limits of coefficients by their names, each in its unit.
        progress: called with the processed and the total time [s], and the current activity.
        on_event: called with each event as it occurs.

    Raises:
        BadInput: a recording does not match the rig, or contradicts the rig file.
    """
    for name, trajectory in (*((part.name, part.trajectory) for part in parts), *baselines.items()):
        check_suits(trajectory, rig, name)  # before the time-consuming compilation
    with Workers() as workers:
        jobs = [*diagnosis_jobs(rig), *identification_jobs(rig)]
        compile_in_parallel(jobs, workers, lambda done, total: progress(done, total, COMPILING))
    progress(0, 1, "learning from the baselines" if baselines else "watching")
    monitor = Monitor(rig, parameters, SynchronousExaminer(), baselines)
    events, stretches = list[Event](), list[RecordingSpan]()
    total = sum(_seconds(part.trajectory) + RECORDING_GAP for part in parts)
    end = 0.0
    for part in parts:
        monitor.interrupt()
        begin = end
        time = part.trajectory.time_s - part.trajectory.time_s[0]
        driven = _driven(part)
        signals = {name: part.trajectory[name] for name in USED if name in part.trajectory}
        for first, last in _chunks(time, driven):
            here = {name: values[first:last] for name, values in signals.items()}
            for event in monitor.add(begin + time[first:last], here):
                events.append(event)
                on_event(event)
            progress(round(begin + time[last - 1]), round(total), f"watching {part.name}")
            if last < len(driven) and not driven[last]:
                monitor.interrupt()
        end = begin + _seconds(part.trajectory)
        stretches.append(RecordingSpan(part.name, begin, end, float(np.sum(np.diff(time)[~driven[1:]]))))
        end += RECORDING_GAP
    monitor.close()
    health = monitor.health()
    rig = monitor.reference
    # Those that the rig does not have are not missing.
    known = {reading.name for reading in health.readings if reading.identified}
    known |= {name for name, c in COEFFICIENTS.items() if rig.cylinder.law.CHAMBERS and c.path in OF_ONE_PRESSURE}
    missing = tuple(name for name in COEFFICIENTS if name not in known) if health.readings else ()
    recorded = [name for name in USED if any(name in part.trajectory for part in parts)]
    progress(round(total), round(total), "selecting an experiment for the other coefficients")
    offered = offer(missing, rig, recorded) if missing else None
    health = health._replace(readings=invalidate_equivalent(health.readings, health.active))
    return MonitoringResult(
        rig=rig,
        parameters=parameters,
        health=health,
        history=tuple(monitor.history),
        events=tuple(events),
        stretches=tuple(stretches),
        limits=predict_limits(health.readings, health.rates, limits, rig),
        missing=missing,
        offer=offered,
    )


def invalidate_equivalent(found: Sequence[Reading], changes: Sequence[FoundChange]) -> tuple[Reading, ...]:
    """Invalidate readings whose effect is attributed to an equivalent cause of an active change.

    For example, if a leakage is modelled as external, the reading of the internal leakage would look healthy.

    Args:
        found: the readings.
        changes: the active changes.
    """
    first = [change.causes[0] for change in changes if change.causes]
    named = {cause.name for cause in first}
    equivalent = {
        name: EFFECTS.load(cause.name).WORDS.noun for cause in first for name in cause.equivalent_to if name not in named
    }
    return tuple(
        reading._replace(
            deviation=math.inf, why_not=f"the change is attributed to {equivalent[effect]}, which is indistinguishable"
        )
        if reading.identified and (effect := COEFFICIENTS[reading.name].effect) in equivalent
        else reading
        for reading in found
    )


def _seconds(trajectory: Trajectory) -> float:
    return float(trajectory.time_s[-1] - trajectory.time_s[0]) if len(trajectory) else 0.0


def _driven(part: MonitoredRecording) -> Mask:
    """Return which samples follow a command that reached the valve, shape (n,)."""
    time = part.trajectory.time_s
    driven = np.ones(len(time), dtype=np.bool_)
    for begin, end in part.pauses:
        driven &= (time < begin) | (time > end)
    return driven


def _chunks(time: Array, driven: Mask) -> list[tuple[int, int]]:
    """Return the ranges of samples passed at once; none spans a pause."""
    turns = np.flatnonzero((np.diff(np.floor(time / CHUNK)) > 0.0) | (driven[1:] != driven[:-1])) + 1
    ends = [0, *turns.tolist(), len(time)]
    return [(first, last) for first, last in pairwise(ends) if last > first and driven[first]]
