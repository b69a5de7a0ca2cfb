"""Rig health reported by a monitor: headline, changes, and each coefficient with a small trend."""

import math
from collections.abc import Iterable
from html import escape

from nicegui import ui

from ehls_ros.dashboard.controls import button
from ehls_ros.dashboard.graph import Graph, RigChange, RigCoefficient, RigHealth
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS
from ehls_ros.experiments.monitoring.trends import NORMAL_95
from ehls_ros.report.quantities import after, percent, unit_for, written

WIDTH, HEIGHT, MARGIN = 96, 22, 2
"""Size of a trend and the room around its line, in pixels."""

GOOD, WARNING = 0, 1


class RigTab:
    """Tab on rig health, hidden without a monitor."""

    def __init__(self, graph: Graph, tab: ui.tab, *, writes: bool) -> None:
        """Build the tab in the current slot.

        Args:
            graph: graph with the monitor.
            tab: selector of the tab.
            writes: whether changes can be acknowledged.
        """
        self._tab = tab
        self._none = ui.label("No monitor is running.").classes("note")
        with ui.element("div").classes("rig") as self._all:
            ui.label("Rig health").classes("title")
            self._summary = ui.label("").props('data-name="rig-summary"')
            self._state = ui.label("").classes("note")
            self._changes = ui.html("", sanitize=False, tag="ul").props('data-name="rig-changes"')
            self._acknowledge = button("Acknowledge changes", graph.acknowledge_changes, "dense outline") if writes else None
            self._coefficients = ui.html("", sanitize=False, tag="div").props('data-name="rig-coefficients"')
        self.show(None)

    def show(self, rig: RigHealth | None) -> None:
        """Update the tab.

        Args:
            rig: report of the monitor; None: no monitor.
        """
        self._tab.set_visibility(rig is not None)
        self._none.set_visibility(rig is None)
        self._all.set_visibility(rig is not None)
        if rig is None:
            return
        new = any(not change.acknowledged for change in rig.changes)
        self._summary.set_text(rig.summary)
        # Visible on every tab until acknowledged.
        for place, wrong in ((self._summary, any(change.active for change in rig.changes)), (self._tab, new)):
            place.classes(add=f"level-{WARNING if wrong else GOOD}", remove=f"level-{GOOD if wrong else WARNING}")
        outside = f"; {percent(rig.outside)} of the last minute is outside the range of the baseline" if rig.outside else ""
        self._state.set_text(f"{rig.state}{outside}")
        self._changes.set_content(changes_list(rig.changes))
        self._changes.set_visibility(bool(rig.changes))
        if self._acknowledge is not None:
            self._acknowledge.set_visibility(new)
        self._coefficients.set_content(trends_table(rig.coefficients))


def changes_list(changes: Iterable[RigChange]) -> str:
    """Return the entries of a list of changes, as HTML."""
    return "".join(
        f'<li class="{"" if change.active else "gone"}">{"" if change.acknowledged else "<b>new</b> "}'
        f"{escape(change.sentence)}{'' if change.active else ' (cleared)'}</li>"
        for change in changes
    )


def trends_table(coefficients: Iterable[RigCoefficient]) -> str:
    """Return a table of coefficients with value and trend, as HTML; grey with the reason where not determined."""
    return f"<table>{''.join(map(_row, coefficients))}</table>"


def _row(coefficient: RigCoefficient) -> str:
    known = COEFFICIENTS.get(coefficient.name)
    name = escape(known.words if known else coefficient.name)
    if coefficient.why_not:
        return f'<tr class="grey"><th>{name}</th><td>{escape(coefficient.why_not)}</td><td>{trend(coefficient)}</td></tr>'
    unit = unit_for(coefficient.unit, abs(coefficient.value))
    text = written(unit.factor * coefficient.value, unit.factor * NORMAL_95 * coefficient.deviation)
    value = f"{text.value} ± {text.error}{after(unit)}"
    return f"<tr><th>{name}</th><td>{escape(value)}</td><td>{trend(coefficient)}</td></tr>"


def trend(coefficient: RigCoefficient) -> str:
    """Return a line through a coefficient's values as SVG, broken where not determined; empty with fewer than two values."""
    points = [(t, v) for t, v in zip(coefficient.times, coefficient.values, strict=True) if math.isfinite(v)]
    if len(points) < 2:
        return ""
    begin, end = coefficient.times[0], coefficient.times[-1]
    low, high = (f(v for _, v in points) for f in (min, max))
    # A trend within its error is flat.
    error = coefficient.deviation if math.isfinite(coefficient.deviation) else 0.0
    span = max(high - low, 4.0 * error, 1e-300)
    middle = 0.5 * (low + high)
    parts, pen = [], "M"
    for time, value in zip(coefficient.times, coefficient.values, strict=True):
        if not math.isfinite(value):
            pen = "M"
            continue
        x = MARGIN + (WIDTH - 2 * MARGIN) * (time - begin) / (end - begin)
        y = 0.5 * HEIGHT - (HEIGHT - 2 * MARGIN) * (value - middle) / span
        parts.append(f"{pen}{x:.1f} {y:.1f}")
        pen = "L"
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}"><path d="{"".join(parts)}"/></svg>'
