"""Monitoring of a rig's recordings for changes as an object, as done by `ehls monitor`."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ehls_ros.api.recordings import Columns, Data, by_name
from ehls_ros.api.results import written
from ehls_ros.api.simulation import RigSource
from ehls_ros.api.simulation import rig as rig_of
from ehls_ros.diagnosis.record import USED
from ehls_ros.experiments.monitoring.health import Event, Health
from ehls_ros.experiments.monitoring.monitor import Parameters
from ehls_ros.experiments.monitoring.replay import MonitoredRecording, MonitoringResult, replay
from ehls_ros.experiments.monitoring.trends import check_limits
from ehls_ros.progress import progress_bar
from ehls_ros.report.monitor import write_monitor_report
from ehls_ros.report.monitor_findings import answer
from ehls_ros.schema import parse

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, repr=False)
class MonitorResult:
    """Changes of a rig over its recordings, and the history of each coefficient.

    Attributes:
        health: final state: ``health.changes``, ``health.readings``, ``health.rates``.
        events: events in order of time.
        name: name of the monitored recordings.
        watched: complete data of file and page.
    """

    health: Health
    events: tuple[Event, ...]
    name: str
    watched: MonitoringResult = field(repr=False)

    @property
    def sentence(self) -> str:
        """The rig's health in a sentence."""
        return answer(self.watched)[0]

    def to_pandas(self) -> "DataFrame":
        """Return the coefficients over time, a row each; value and standard error are NaN if not identifiable."""
        from pandas import DataFrame  # noqa: PLC0415 - half a second that only tables cost

        columns = ["time_s", "coefficient", "value", "std", "unit", "why_not"]
        nan = float("nan")
        rows = [
            (past.time, r.name, *((r.value, r.deviation) if r.identified else (nan, nan)), r.unit, r.why_not)
            for past in self.watched.history
            for r in past.readings
        ]
        return DataFrame(rows, columns=columns)

    def report(self, path: str | Path) -> Path:
        """Write the HTML report of `ehls monitor` and return its path.

        Raises:
            BadInput: the file cannot be written.
        """
        return written(path, lambda file: write_monitor_report(self.watched, file, self.name))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return f"<{type(self).__name__} {self.name}: {self.sentence}>"

    def _repr_html_(self) -> str:
        items = "".join(f"<li>{event.time:.1f} s: {escape(event.text)}</li>" for event in self.events)
        return f"<p><b>{escape(self.sentence)}</b></p><ul>{items}</ul>"


def monitor(
    data: Data | Iterable[Data],
    rig: RigSource,
    *,
    columns: Columns | None = None,
    baseline: Data | Iterable[Data] = (),
    mean_time_between_false_alarms: float = 1000.0,
    learning_time: float = 60.0,
    reading_time: float = 10.0,
    limits: Mapping[str, float] | None = None,
    progress: bool = True,
) -> MonitorResult:
    """Monitor recordings for changes as if online, with a specified false-alarm rate.

    Args:
        data: one or several recordings, or their paths, in chronological order.
        rig: the healthy rig, or its file.
        columns: names and units used in the data, for paths.
        baseline: one or several recordings of the healthy rig; none: the monitor learns from the first samples.
        mean_time_between_false_alarms: lower limit [h].
        learning_time: learning time without a baseline [s].
        reading_time: time over which coefficients are averaged [s].
        limits: limits of coefficients by name, each in its unit, such as ``{"leakage_coefficient": 1.2e-11}``.
        progress: show a progress bar, in a notebook or on a terminal.

    Returns:
        The rig's health, the events, and the coefficients over time. All samples count as driven, whereas `ehls monitor` omits
        the parts of a bag in which the safety gate was closed.

    Raises:
        BadInput: a value is wrong, the data or the rig cannot be read, or the data are not of such a rig.
    """
    asked = {
        "mean_time_between_false_alarms": mean_time_between_false_alarms,
        "learning_time": learning_time,
        "reading_time": reading_time,
    }
    parameters = parse(Parameters, asked, "monitor")
    model = rig_of(rig)
    check_limits(limits or {}, model, "limits")
    with progress_bar("watching", shown=progress, lines=False) as bar:
        recordings, baselines = by_name(data, columns, USED), by_name(baseline, columns, USED)
        watched = replay(
            [MonitoredRecording(name, recording) for name, recording in recordings.items()],
            model,
            parameters,
            baselines=baselines,
            limits=limits or {},
            progress=bar,
            on_event=lambda _: None,
        )
    return MonitorResult(health=watched.health, events=tuple(watched.events), name=", ".join(recordings), watched=watched)
