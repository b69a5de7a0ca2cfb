"""The page: plots of the signals, the nodes' diagnostics, and controls for pages that may write."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from nicegui import ui
from numpy.typing import NDArray

from ehls_ros.dashboard.beginning import BeginningCard
from ehls_ros.dashboard.controls import button
from ehls_ros.dashboard.experiment import ExperimentTab
from ehls_ros.dashboard.graph import Beginning, Graph, Health
from ehls_ros.dashboard.panels import PANELS, SPAN, Panel, options
from ehls_ros.dashboard.tuning import TuningTab
from ehls_ros.dashboard.window import INTERVAL

FOLDER = Path(__file__).parent

PICTURES = 0.1
"""Time between two updates of the plots [s]."""

WORDS = 0.5
"""Time between two updates of the texts [s]."""

GATE_STATE = "state"
"""Diagnostics key by which the node with the safety gate is known."""

STOP = "stop"
"""Diagnostics key that names the emergency stop while one is engaged."""

PAUSE = '<input type="checkbox" onchange="ehlsLive.pause(this.checked)"> pause'
"""Handled in the browser alone, since a read-only page cannot send events."""

TOO_SLOW = "too slow"
"""Part of a node's message when this machine cannot keep its cycle time."""

LEVELS = ("OK", "warning", "error", "silent")
"""Names of the levels of :class:`Health`."""


class Page:
    """One browser's page."""

    def __init__(self, graph: Graph, spec: Path | None, *, writes: bool) -> None:
        """Build the page; timers keep it up to date once a browser has loaded it.

        Args:
            graph: the graph it shows.
            spec: experiment file preselected for Start.
            writes: whether it may change things. If not, no controls exist, neither in the browser nor here.
        """
        self._graph = graph
        self._client = ui.context.client
        self._following, self._era = 0, -1
        self._was_there = False
        self._tuning: TuningTab | None = None
        self._experiment: ExperimentTab | None = None
        self._acknowledge: ui.button | None = None
        ui.add_css(FOLDER / "style.css")
        self._head(writes=writes)
        with ui.element("div").classes("plots"):
            charts = [_plot(panel) for panel in PANELS]
        self._beginning = BeginningCard(graph, writes=writes)
        with ui.element("div").classes("side"):
            self._side(spec, writes=writes)
        settings = {"interval": INTERVAL, "kept": round(SPAN / INTERVAL), "charts": charts}
        script = (FOLDER / "live.js").read_text(encoding="utf-8")
        ui.add_body_html(f"<script>{script}\nehlsLive.begin({_json(settings)})</script>")
        self._show_words()
        ui.timer(PICTURES, self._send_pictures)
        ui.timer(WORDS, self._send_words)

    def _head(self, *, writes: bool) -> None:
        graph = self._graph
        with ui.element("div").classes("head"):
            ui.html("Electro-hydraulic load simulator", sanitize=False, tag="h1")
            self._state = ui.label("no graph").classes("badge").props('data-name="state"')
            self._gate = ui.label("").classes("badge").props('data-name="gate"')
            self._gate.set_visibility(False)
            ui.label(graph.where).classes("said").props('data-name="where"')
            ui.element("div").classes("grow")
            if not writes:
                ui.label("read only: controls need the address with the token").classes("said").props('data-name="read-only"')
            ui.html(PAUSE, sanitize=False, tag="label").classes("pause")
            if writes:
                self._acknowledge = button("Acknowledge stop", graph.acknowledge_stop, "flat dense")
                self._acknowledge.set_visibility(False)
                button("Reset trips", graph.reset_trips, "flat dense")
                button("Enable", graph.enable, "outline dense")
                button("Emergency stop", graph.emergency_stop, "dense color=negative")
        self._trouble = ui.label("").classes("trouble").props('data-name="trouble"')
        self._trouble.set_visibility(False)
        lost = "The dashboard's server does not answer: it was stopped, the connection is lost, or the machine is too busy."
        ui.label(lost).classes("trouble lost")

    def _side(self, spec: Path | None, *, writes: bool) -> None:
        names = ("Tune", "Experiment", "Nodes") if writes else ("Nodes",)
        with ui.tabs().props("dense no-caps align=justify") as tabs:
            made = {name: ui.tab(name).props(f'data-name="tab-{name.lower()}"') for name in names}
        with ui.tab_panels(tabs, value=made[names[0]], animated=False, keep_alive=True):
            if writes:
                with ui.tab_panel(made["Tune"]):
                    self._tuning = TuningTab(self._graph)
                with ui.tab_panel(made["Experiment"]):
                    self._experiment = ExperimentTab(self._graph, spec)
            with ui.tab_panel(made["Nodes"]):
                self._nodes = NodesTab()

    def _send_pictures(self) -> None:
        window = self._graph.window
        part = window.part(self._following, self._era)
        self._following, self._era = part.following, part.era
        message = {
            "first": part.first,
            "era": part.era,
            "low": dict(zip(window.signals, _columns(part.low), strict=True)),
            "high": dict(zip(window.signals, _columns(part.high), strict=True)),
        }
        self._client.run_javascript(f"ehlsLive.extend({_json(message)})")

    async def _send_words(self) -> None:
        self._show_words()
        if self._tuning is not None:
            await self._tuning.follow()

    def _show_words(self) -> None:
        rate, health, beginning = self._graph.rate(), self._graph.health(), self._graph.beginning()
        self._was_there |= rate > 0.0
        slow = next((f"{node.node}: {node.message}" for node in health if TOO_SLOW in node.message), "")
        self._show_state(rate, beginning, slow=bool(slow))
        gate = next((node for node in health if GATE_STATE in node.figures), None)
        self._gate.set_text(f"gate {gate.figures[GATE_STATE]}" if gate else "")
        self._gate.set_visibility(gate is not None)
        if self._acknowledge is not None:
            self._acknowledge.set_visibility(gate is not None and bool(gate.figures.get(STOP)))
        _set_level(self._gate, gate.level if gate else 0)
        self._beginning.show(beginning, was_there=self._was_there)
        self._show_trouble(health, slow, there=rate > 0.0 or beginning is not None)
        self._nodes.show(health)
        if self._experiment is not None:
            self._experiment.show()

    def _show_state(self, rate: float, beginning: Beginning | None, *, slow: bool) -> None:
        if rate:
            text, level = f"{TOO_SLOW if slow else 'running'}, {rate:.0f} cycles/s", int(slow)
        elif beginning:
            text, level = f"starting, {beginning.seconds:.0f} s", 1
        else:
            text, level = ("graph gone", 3) if self._was_there else ("no graph", 1)
        self._state.set_text(text)
        _set_level(self._state, level)

    def _show_trouble(self, health: tuple[Health, ...], slow: str, *, there: bool) -> None:
        worst = max(health, key=lambda node: node.level, default=None)
        text = self._graph.complaint()
        if not text and self._was_there and not there:
            text = "No more snapshots: the graph was stopped, or the plant node has died."
        elif not text and worst is not None and worst.level:
            text = f"{worst.node}: {worst.message}"
            if slow and slow != text:
                # The cause before its consequence.
                text = f"{slow}. {text}"
        self._trouble.set_text(text)
        self._trouble.set_visibility(bool(text))


class NodesTab:
    """Each node's diagnostics; its values unfold on a click."""

    def __init__(self) -> None:
        """Build the tab in the current slot."""
        self._none = ui.label("No node publishes diagnostics.").classes("said")
        self._list = ui.element("div").classes("nodes")
        self._rows: dict[str, _Row] = {}

    def show(self, health: tuple[Health, ...]) -> None:
        """Update the rows."""
        self._none.set_visibility(not health)
        if [node.node for node in health] != list(self._rows):
            self._list.clear()
            with self._list:
                self._rows = {node.node: _Row(node.node) for node in health}
        for node in health:
            self._rows[node.node].show(node)


class _Row:
    """One node."""

    def __init__(self, name: str) -> None:
        with ui.element("details") as row:
            # Set as an item: NiceGUI parses a string of properties, and the browser evaluates some of them.
            row.props["data-name"] = f"node-{name}"
            with ui.element("summary"):
                ui.html(escape(name), sanitize=False, tag="b")
                self._level = ui.label("").classes("badge")
                self._message = ui.label("").classes("said")
            self._figures = ui.html("", sanitize=False, tag="dl")

    def show(self, health: Health) -> None:
        self._level.set_text(LEVELS[health.level])
        _set_level(self._level, health.level)
        self._message.set_text(health.message)
        cells = (f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in health.figures.items())
        self._figures.set_content("".join(cells))


def _set_level(badge: ui.label, level: int) -> None:
    badge.classes(add=f"level-{level}", remove=" ".join(f"level-{i}" for i in range(len(LEVELS)) if i != level))


def _plot(panel: Panel) -> dict[str, Any]:
    """Make an empty plot, and return what the browser needs to fill it."""
    legend = [f'<span class="c{line.colour}">{escape(line.label)}</span>' for line in panel.lines]
    lines = [{"signal": line.signal, "factor": line.factor, "colour": line.colour} for line in panel.lines]
    lines += [{**lines[number], "factor": -line.factor} for number, line in enumerate(panel.lines) if line.mirrored]
    with ui.element("section").classes("plot"):
        ui.html(f"<b>{escape(panel.title)}</b>{''.join(legend)}", sanitize=False, tag="header")
        chart = ui.echart(options(panel))
    return {"id": chart.id, "lines": lines}


def _columns(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return one row per signal; single precision is enough for a plot."""
    return np.ascontiguousarray(values.T, dtype=np.float32)


def _json(content: Any) -> str:
    """Return JSON that is safe inside a script element; NaN and infinity become null."""
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY).decode().replace("</", "<\\/")
