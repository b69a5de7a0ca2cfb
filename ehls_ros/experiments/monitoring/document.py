"""``monitor.json``: its schema as frozen records, and how what a monitor knows fills them. The field names are the keys."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ehls_ros import __version__
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Reading
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.health import Event, FoundChange
from ehls_ros.experiments.monitoring.limits import NORMAL_95, Reach
from ehls_ros.experiments.monitoring.offer import Offer
from ehls_ros.experiments.monitoring.replay import Stretch, Watched


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
    """A coefficient at the end.

    Attributes:
        value: its value; the model's where it is not told.
        std: standard error; None where it is not told.
        ci95: 95 % interval.
        unit: unit of these.
        told: whether the programme tells it.
        why_not: why it does not.
        healthy: the value in the rig file.
        rate: its change in an hour, with standard error.
        limit: when it reaches its limit, if it has one.
    """

    value: float
    std: float
    ci95: tuple[float, float]
    unit: str
    told: bool
    why_not: str
    healthy: float
    rate: Estimate | None
    limit: Reach | None


class MonitorDocument(NamedTuple):
    """What ``monitor.json`` holds; times are seconds on the axis on which the recordings stand.

    Attributes:
        summary: the rig's health in a sentence.
        healthy: whether no change shows; None where nothing could be judged.
        state: what the monitor was doing at the end.
        reason: why nothing is judged, if so.
        baseline: what a change is measured from.
        mean_time_between_false_alarms: that was set [h].
        watched: time for which samples were judged [s].
        outside: fraction of the last minute that lies outside what the baseline covers.
        recordings: where each stands on the axis.
        changes: what was found, oldest first.
        coefficients: by name.
        events: what happened.
        offer: the shortest experiment that tells what this programme does not.
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
    recordings: Sequence[Stretch]
    changes: tuple[ChangeEntry, ...]
    coefficients: Mapping[str, CoefficientEntry]
    events: Sequence[Event]
    offer: Offer | None
    version: str
    wall_s: float


def monitor_document(watched: Watched, summary: str, healthy: bool | None, wall_s: float) -> MonitorDocument:
    """Return what ``monitor.json`` holds.

    Args:
        watched: what the monitor knows.
        summary: that in a sentence.
        healthy: whether no change shows.
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


def _coefficient(reading: Reading, watched: Watched) -> CoefficientEntry:
    half = NORMAL_95 * reading.deviation
    return CoefficientEntry(
        value=reading.value,
        std=reading.deviation,
        ci95=(reading.value - half, reading.value + half),
        unit=reading.unit,
        told=reading.told,
        why_not=reading.why_not,
        healthy=COEFFICIENTS[reading.name].given(watched.rig),
        rate=watched.health.rates.get(reading.name),
        limit=watched.limits.get(reading.name),
    )
