"""``monitor.json``: its schema as frozen records, and their creation from a monitor's results; field names are the keys."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ehls_ros import __version__
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Reading
from ehls_ros.diagnosis.result import Fitted
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.health import Event, FoundChange
from ehls_ros.experiments.monitoring.offer import Offer
from ehls_ros.experiments.monitoring.replay import MonitoringResult, RecordingSpan
from ehls_ros.experiments.monitoring.trends import NORMAL_95, LimitPrediction


class ChangeEntry(NamedTuple):
    """A change of the rig; attributes as in :class:`~ehls_ros.experiments.monitoring.health.FoundChange`."""

    number: int
    cause: str
    stage: str
    probability: float | None
    equivalent_to: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    depends_on: tuple[str, ...]
    since: float
    earliest: float
    latest: float
    noticed: float
    named: float
    cleared: float
    active: bool
    sentence: str


class CoefficientEntry(NamedTuple):
    """Final state of a coefficient.

    Attributes:
        value: its value; that of the model if not determined.
        std: standard error; None if not determined.
        ci95: 95 % interval.
        unit: unit of these.
        told: whether the programme determines it.
        why_not: reason if it does not.
        healthy: the value of the healthy rig: the rig file's, or the identified one if the file is wrong.
        rate: its change per hour, with standard error.
        limit: prediction of reaching its limit, if it has one.
    """

    value: float
    std: float
    ci95: tuple[float, float]
    unit: str
    told: bool
    why_not: str
    healthy: float
    rate: Estimate | None
    limit: LimitPrediction | None


class MonitorDocument(NamedTuple):
    """Content of ``monitor.json``; times are seconds on the time axis of the recordings.

    Attributes:
        summary: the rig's health in a sentence.
        healthy: whether no change is active; None if nothing could be judged.
        state: state of the monitor at the end.
        reason: reason if nothing is judged.
        baseline: description of the baseline.
        mean_time_between_false_alarms: as set [h].
        watched: time for which samples were judged [s].
        outside: fraction of the last minute outside the range of the baseline.
        recordings: position of each on the time axis.
        changes: detected changes, oldest first.
        coefficients: coefficients by name.
        events: events in order.
        rig_values: numbers of the rig file that the recordings of the healthy rig contradict, by dotted section and name.
        offer: shortest experiment for the coefficients that this programme does not determine.
        version: version of this package.
        wall_s: wall time of everything [s].
    """

    summary: str
    healthy: bool | None
    state: str
    reason: str
    baseline: str
    mean_time_between_false_alarms: float
    watched: float
    outside: float
    recordings: Sequence[RecordingSpan]
    changes: tuple[ChangeEntry, ...]
    coefficients: Mapping[str, CoefficientEntry]
    events: Sequence[Event]
    rig_values: Mapping[str, Fitted]
    offer: Offer | None
    version: str
    wall_s: float


def monitor_document(watched: MonitoringResult, summary: str, healthy: bool | None, wall_s: float) -> MonitorDocument:
    """Return the content of ``monitor.json``.

    Args:
        watched: results of the monitor.
        summary: the rig's health in a sentence.
        healthy: whether no change is active.
        wall_s: wall time of everything [s].
    """
    health = watched.health
    return MonitorDocument(
        summary=summary,
        healthy=healthy,
        state=health.state.name.lower(),
        reason=health.reason,
        baseline=health.baseline,
        mean_time_between_false_alarms=watched.parameters.mean_time_between_false_alarms,
        watched=health.watched,
        outside=health.outside,
        recordings=watched.stretches,
        changes=tuple(map(_change, health.changes)),
        coefficients={reading.name: _coefficient(reading, watched) for reading in health.readings},
        events=watched.events,
        rig_values=health.rig_values,
        offer=watched.offer,
        version=__version__,
        wall_s=wall_s,
    )


def _change(change: FoundChange) -> ChangeEntry:
    cause = change.causes[0] if change.causes else None
    return ChangeEntry(
        number=change.number,
        cause="unknown" if cause is None else cause.name,
        stage=change.stage,
        probability=None if cause is None else cause.probability,
        equivalent_to=() if cause is None else cause.equivalent_to,
        parameters={} if cause is None else cause.parameters,
        depends_on=change.depends_on,
        since=change.since,
        earliest=change.earliest,
        latest=change.latest,
        noticed=change.noticed,
        named=change.named,
        cleared=change.cleared,
        active=change.active,
        sentence=change.sentence(),
    )


def _coefficient(reading: Reading, watched: MonitoringResult) -> CoefficientEntry:
    half = NORMAL_95 * reading.deviation
    return CoefficientEntry(
        value=reading.value,
        std=reading.deviation,
        ci95=(reading.value - half, reading.value + half),
        unit=reading.unit,
        told=reading.identified,
        why_not=reading.why_not,
        healthy=COEFFICIENTS[reading.name].given(watched.rig),
        rate=watched.health.rates.get(reading.name),
        limit=watched.limits.get(reading.name),
    )
