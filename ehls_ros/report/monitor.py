"""Report of a monitor: the rig's health, events, trends of the coefficients, and those not identifiable."""

from collections.abc import Sequence
from datetime import date, datetime, timedelta
from pathlib import Path

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, PastReadings, Reading
from ehls_ros.experiments.monitoring.health import Event
from ehls_ros.experiments.monitoring.replay import MonitoringResult
from ehls_ros.experiments.monitoring.trends import NORMAL_95
from ehls_ros.report import page
from ehls_ros.report.diagnosis_findings import capital
from ehls_ros.report.monitor_findings import (
    FROM_ZERO,
    HEADER,
    HOUR,
    IN_MINUTES,
    IN_SECONDS,
    MINUTE,
    Clock,
    answer,
    change_sentence,
    covers_all,
    duration,
    false_alarms,
    known,
    limit_text,
    offered,
    outside,
    table_row,
)
from ehls_ros.report.page import LeftOut, Panel, Row
from ehls_ros.report.plot import (
    BLUE,
    GREY,
    PURE_NUMBER,
    VERMILION,
    Axis,
    Layout,
    Trace,
    Unit,
    dots,
    line,
    region,
    shade,
    stacked_layout,
    time_layout,
    time_mark,
)
from ehls_ros.report.quantities import percent, unit_for

DAY_SECONDS = 86400.0

MAX_LISTED_EVENTS = 12
"""Maximum number of events listed without a click."""


class _Scale:
    """Time axis of all figures."""

    def __init__(self, watched: MonitoringResult, clock: Clock) -> None:
        """Choose unit and span of the axis."""
        times = [watched.health.time, *(event.time for event in watched.events), *(past.time for past in watched.history)]
        self.end = max((time for time in times if np.isfinite(time)), default=1.0)
        if clock.zero is None:
            self.begin, self.quantity, longest = 0.0, "time since start", self.end
        else:
            midnight = datetime.combine(clock.zero.date(), datetime.min.time(), clock.zero.tzinfo)
            self.begin, self.quantity, longest = (midnight - clock.zero).total_seconds(), "time of day", DAY_SECONDS
            self.end = self.begin + DAY_SECONDS
        self.unit = next(
            unit
            for most, unit in (
                (IN_SECONDS, Unit("s")),
                (IN_MINUTES, Unit("min", 1.0 / MINUTE)),
                (np.inf, Unit("h", 1.0 / HOUR)),
            )
            if longest <= most
        )

    def at(self, seconds: Array | float) -> Array:
        """Return times in the unit of the axis."""
        return np.asarray((np.asarray(seconds, dtype=np.float64) - self.begin) * self.unit.factor)

    def layout(self, rows: Sequence[Axis]) -> Layout:
        """Return the layout of a figure over time."""
        span = (0.0, float(self.at(self.end)))
        layout = time_layout(span[1], rows)
        layout["xaxis"] = stacked_layout(Axis(self.quantity, self.unit, span), rows)["xaxis"]
        layout["xaxis"]["unifiedhovertitle"] = {"text": f"%{{x:,.5~g}} {self.unit.symbol}"}
        return layout


def daily_report(watched: MonitoringResult, folder: Path, day: date, clock: Clock, out: Path | None = None) -> Path:
    """Write the report of one day and return its path.

    Args:
        watched: state of the monitor at the end of the day; history and events are limited to the day.
        folder: folder of the reports; it must exist.
        day: the day, in the clock's time zone.
        clock: the wall time at which the monitor's axis is 0.
        out: the file; by default one in the folder that is named after the day.

    Raises:
        ValueError: the clock has no wall time.
    """
    if clock.zero is None:
        raise ValueError("a daily report needs the wall time at which the monitor's axis is 0")
    midnight = datetime.combine(day, datetime.min.time(), clock.zero.tzinfo)
    begin = (midnight - clock.zero).total_seconds()
    end = (midnight + timedelta(days=1) - clock.zero).total_seconds()

    health = watched.health
    of_day = watched._replace(
        health=health._replace(
            time=health.time - begin, changes=tuple(change.with_times(lambda time: time - begin) for change in health.changes)
        ),
        history=tuple(past._replace(time=past.time - begin) for past in watched.history if begin <= past.time < end),
        events=tuple(event._replace(time=event.time - begin) for event in watched.events if begin <= event.time < end),
        stretches=(),
    )
    path = out or folder / f"report-{day:%Y-%m-%d}.html"
    write_monitor_report(of_day, path, f"{day:%A, %d %B %Y}", Clock(midnight))
    return path


def write_monitor_report(watched: MonitoringResult, path: Path, source: str = "", clock: Clock = FROM_ZERO) -> None:
    """Write one self-contained HTML file on a rig's health and its history.

    Args:
        watched: state of the monitor.
        path: file to write; its folder must exist.
        source: name of the monitored recordings, for the line below the heading.
        clock: format of times; with a wall time the figures show its day.
    """
    sentence, good = answer(watched, clock)
    scale = _Scale(watched, clock)
    panels = [_trend(reading, watched, scale) for reading in known(watched)]
    parts = [
        ("Changes", _changes(watched, clock)),
        ("Events", _events(watched, scale, clock)),
        (
            "Coefficients",
            [page.table(HEADER, [table_row(reading, watched) for reading in known(watched) if reading.identified])],
        ),
        ("Trends", [page.figures(panels, columns=2)]),
        ("Not identified", _not_identified(watched, panels)),
        ("Judged data", [page.bullets([false_alarms(watched.parameters.mean_time_between_false_alarms), _judged(watched)])]),
        ("Method", [page.paragraph(_METHOD)]),
    ]
    title = {True: "The rig is healthy", False: "The rig has changed", None: "The rig is not judged"}[good]
    page.write_page(path, title, source, [page.verdict(sentence, good=good), _facts(watched), *page.sections(parts)])


def _facts(watched: MonitoringResult) -> str:
    health = watched.health
    identified = sum(reading.identified for reading in known(watched))
    return page.facts(
        [
            ("monitored", duration(health.watched)),
            ("baseline", health.baseline),
            ("false alarms, at most", f"one in {watched.parameters.mean_time_between_false_alarms:g} h"),
            ("coefficients identified", f"{identified} of {len(COEFFICIENTS)}"),
            *([] if covers_all(health.baseline) else [("outside the baseline", percent(health.outside))]),
        ]
    )


def _judged(watched: MonitoringResult) -> str:
    idle = sum(stretch.not_driven for stretch in watched.stretches)
    driven = f" Of the recordings, {duration(idle)} were not driven and are not judged." if idle > 0.0 else ""
    return f"{outside(watched.health.outside, watched.health.baseline)}{driven}"


def _changes(watched: MonitoringResult, clock: Clock) -> list[str]:
    table = page.table_of(
        watched.health.changes,
        {
            "number": lambda change: str(change.number),
            "change": lambda change: change_sentence(change, watched.rig, clock),
            "named at": lambda change: clock.text(change.named),
            "state": lambda change: "active" if change.active else f"cleared at {clock.text(change.cleared)}",
        },
    )
    return [table] if table else []


def _events(watched: MonitoringResult, scale: _Scale, clock: Clock) -> list[str]:
    events = watched.events
    if not events:
        return []
    kinds = list(dict.fromkeys(event.kind for event in events))
    rows: list[Row] = [[clock.text(event.time), event.kind, event.text] for event in events]
    listing = page.table(["time", "event", "description"], rows)
    if len(rows) > MAX_LISTED_EVENTS:
        text = "\n".join(f"{clock.text(event.time)}  {event.kind}: {event.text}" for event in events)
        listing = page.collapsed(f"All {len(events)} events", text)
    return [page.figures([_time_line(events, kinds, watched, scale)]), listing]


def _time_line(events: Sequence[Event], kinds: Sequence[str], watched: MonitoringResult, scale: _Scale) -> Panel:
    traces: list[Trace] = []
    for place, kind in enumerate(kinds, start=1):
        own = [event for event in events if event.kind == kind]
        at = scale.at(np.array([event.time for event in own]))
        mark = dots(at, np.full(len(own), float(place)), kind, PURE_NUMBER, BLUE, remarks=[event.text for event in own])
        traces.append(mark | {"hovertemplate": "%{text}", "showlegend": False})
    traces += [time_mark(float(scale.at(stretch.begin)), stretch.name, GREY) for stretch in watched.stretches[1:]]
    layout = scale.layout([Axis("", PURE_NUMBER, (len(kinds) + 0.6, 0.4), names=tuple(kinds))])
    return Panel("Events over time", traces, layout | {"hovermode": "closest"}, height=110 + 26 * len(kinds))


# --- trends ------------------------------------------------------------------------------------


def _trend(reading: Reading, watched: MonitoringResult, scale: _Scale) -> Panel | LeftOut:
    """Draw a coefficient over time; grey where it was not identifiable from the programme."""
    title = capital(COEFFICIENTS[reading.name].words)
    past = [(time, one) for time, one in _past(reading, watched) if time <= scale.end]
    identified = np.array([one.identified for _, one in past], dtype=np.bool_)
    if not np.any(identified):
        return LeftOut(title, reading.why_not)
    times = np.array([time for time, _ in past])
    values = np.where(identified, [one.value for _, one in past], np.nan)
    half = NORMAL_95 * np.where(identified, [one.deviation for _, one in past], np.nan)
    given = COEFFICIENTS[reading.name].given(watched.rig)
    limit = watched.limits.get(reading.name)
    shown = [given, *([limit.limit] if limit else [])]
    unit = unit_for(past[int(np.argmax(identified))][1].unit, float(np.nanmax(np.abs([*values[identified], *shown]))))
    # A reading covers the time over which it is averaged.
    starts = times - watched.parameters.reading_time
    traces: list[Trace] = []
    for first, last in _runs(identified):
        x = scale.at(np.concatenate([[max(starts[first], scale.begin)], times[first:last]]))
        y, width = (np.concatenate([[v[first]], v[first:last]]) for v in (values, half))
        shared = {"showlegend": first == _runs(identified)[0][0]}
        traces.append(region(x, y - width, y + width, "95 %", unit, BLUE, 0.22) | shared | {"legendgroup": "band"})
        traces.append(line(x, y, "value", unit, BLUE, width=2.0) | shared | {"legendgroup": "value"})
    ends = scale.at(np.array([scale.begin, scale.end]))
    traces.append(line(ends, np.full(2, given), "healthy", unit, GREY, dash="dash", width=1.2))
    if limit is not None:
        traces.append(line(ends, np.full(2, limit.limit), "limit", unit, VERMILION, dash="dash", width=1.2))
    begun = [change.since for change in watched.health.changes if scale.begin <= change.since <= scale.end]
    traces += [
        time_mark(float(scale.at(since)), "change", VERMILION) | {"legendgroup": "change", "showlegend": not place}
        for place, since in enumerate(begun)
    ]
    layout = scale.layout([Axis(COEFFICIENTS[reading.name].words, unit)])
    layout["shapes"] = [
        _grey(*scale.at(np.array([starts[first], times[last - 1]])).tolist()) for first, last in _runs(~identified)
    ]
    layout["yaxis"]["tickformat"] = "~g"
    return Panel(title, traces, layout, _trend_note(reading, watched, grey=not np.all(identified)), height=250)


def _past(reading: Reading, watched: MonitoringResult) -> list[tuple[float, Reading]]:
    """Return the readings of a coefficient with their times, the newest last."""
    newest = PastReadings(watched.health.time, watched.health.readings)
    behind = [past for past in watched.history if past.time < newest.time - 1.0] if newest.readings else list(watched.history)
    return [
        (past.time, one)
        for past in (*behind, *([newest] if newest.readings else []))
        for one in past.readings
        if one.name == reading.name
    ]


def _runs(chosen: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[tuple[int, int]]:
    """Return the beginning and the end, exclusive, of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _grey(begin: float, end: float) -> Layout:
    """Return the shape of an interval in which a coefficient was not identifiable."""
    place = {"type": "rect", "xref": "x", "yref": "paper", "x0": begin, "x1": end, "y0": 0.0, "y1": 1.0}
    return place | {"fillcolor": shade(GREY, 0.18), "line": {"width": 0}, "layer": "below"}


def _trend_note(reading: Reading, watched: MonitoringResult, *, grey: bool) -> str:
    """Return a note on a coefficient's change, the time to its limit and, if so, why it is not identifiable."""
    _, _, _, change, _ = table_row(reading, watched)
    limit = watched.limits.get(reading.name)
    parts = [f"Change per hour: {change}." if reading.identified and change[:1].strip("–") else ""]
    parts.append("" if limit is None or not reading.identified else f"Limit {limit_text(limit, reading.unit)}.")
    parts.append(f"Not identified now: {reading.why_not}." if not reading.identified else "")
    parts.append("Grey: not identified." if grey else "")
    return " ".join(filter(None, parts))


def _not_identified(watched: MonitoringResult, panels: Sequence[Panel | LeftOut]) -> list[str]:
    never = {panel.title: panel.reason for panel in panels if isinstance(panel, LeftOut)}
    rows: list[Row] = [
        [COEFFICIENTS[reading.name].words, reading.why_not]
        for reading in known(watched)
        if not reading.identified or capital(COEFFICIENTS[reading.name].words) in never
    ]
    if not rows:
        return []
    offer, text = watched.offer, offered(watched)
    spec = [] if offer is None else [page.collapsed("The proposed experiment", page.as_yaml(offer.spec))]
    return [page.table(["coefficient", "reason"], rows), *([page.paragraph(text)] if text else []), *spec]


_METHOD = (
    "The samples are divided into blocks of a few seconds. The residuals of each block are projected on the change due to"
    " each known departure; this gives a score and its information, which are added over blocks. A change is detected if a"
    " sum over the last seconds to an hour exceeds the bound that chance exceeds once in the mean time between false alarms,"
    " for all departures and times together, with the scatter of the healthy rig's blocks. A detected change is diagnosed"
    " against the healthy rig with the samples since its onset. The coefficients are fitted jointly to the last blocks,"
    " linearised around the model; their intervals follow from the same scatter and include no error common to the whole"
    " model."
)
"""Description of the method."""
