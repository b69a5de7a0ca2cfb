"""The page: plots of the signals, the nodes' diagnostics, and controls for pages that may write."""

from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from nicegui import ui
from numpy.typing import NDArray

from ehls_ros.dashboard.controls import button
from ehls_ros.dashboard.experiment import ExperimentTab
from ehls_ros.dashboard.graph import Graph, NodeHealth, StartProgress, Timing
from ehls_ros.dashboard.panels import PANELS, SIGNALS, SPANS, UNITS, Panel, options
from ehls_ros.dashboard.rig_health import RigTab
from ehls_ros.dashboard.status import (
    PROGRAMME_BUTTONS,
    WARNING,
    Remedy,
    programme_figures,
    programme_line,
    programme_requests,
    status_of,
)
from ehls_ros.dashboard.tuning import TuningTab
from ehls_ros.dashboard.tuning_section import TuningSection
from ehls_ros.dashboard.window import INTERVAL

FOLDER = Path(__file__).parent

PLOT_INTERVAL = 0.1
"""Time between two updates of the plots [s]."""

TEXT_INTERVAL = 0.5
"""Time between two updates of the texts [s]."""

PAUSE = '<input type="checkbox" onchange="ehlsLive.pause(this.checked)"> pause'
"""Handled in the browser alone, as is the choice of signals, since a read-only page cannot send events."""

MENU = '<details class="menu"><summary>{label}</summary><div id="{id}" class="choices"></div></details>'
"""A menu that the browser fills."""

LEVELS = ("OK", "warning", "error", "silent")
"""Names of the levels of :class:`Health`."""

COMPILING_TEXT = (
    "The control law and the simulated rig are being compiled for this machine: about half a minute the first time, a few "
    "seconds later on. The plots then start automatically."
)

NO_GRAPH_TEXT = "The plots start automatically when a graph runs."

NO_GRAPH_TEXT_WITH_CONTROLS = "Start one under Experiment or from another terminal. The plots then start automatically."


class Page:
    """One browser's page."""

    def __init__(self, graph: Graph, spec: Path | None, timing: Timing, *, writes: bool) -> None:
        """Build the page; timers keep it up to date once a browser has loaded it.

        Args:
            graph: the graph shown.
            spec: experiment file preselected for Start.
            timing: preselected for Start.
            writes: whether it may change things. If not, no controls exist, neither in the browser nor here.
        """
        self._graph = graph
        self._client = ui.context.client
        self._following, self._era = 0, -1
        self._graph_seen = False
        self._tuning_section: TuningSection | None = None
        self._tuning: TuningTab | None = None
        self._applications = 0
        self._experiment: ExperimentTab | None = None
        self._remedies: dict[Remedy, ui.button] = {}
        self._requests: dict[str, ui.button] = {}
        ui.add_css(FOLDER / "style.css")
        self._head(writes=writes)
        with ui.element("div").classes("plots"):
            charts = [_plot(panel) for panel in PANELS]
        self._start_card = StartCard(graph, writes=writes)
        with ui.element("div").classes("side"):
            self._side(spec, timing, writes=writes)
        settings = {
            "interval": INTERVAL,
            "kept": round(max(SPANS) / INTERVAL),
            "spans": SPANS,
            "units": {own: dict(units) for own, units in UNITS.items()},
            "signals": {name: signal._asdict() for name, signal in SIGNALS.items()},
            "charts": charts,
        }
        script = (FOLDER / "live.js").read_text(encoding="utf-8")
        ui.add_body_html(f"<script>{script}\nehlsLive.begin({_json(settings)})</script>")
        self._show_texts()
        ui.timer(PLOT_INTERVAL, self._send_plots)
        ui.timer(TEXT_INTERVAL, self._send_texts)

    def _head(self, *, writes: bool) -> None:
        graph = self._graph
        with ui.element("div").classes("head"):
            ui.html("Electro-hydraulic load simulator", sanitize=False, tag="h1")
            self._state = ui.label("no graph").classes("badge").props('data-name="state"')
            ui.label(graph.where).classes("note").props('data-name="where"')
            ui.element("div").classes("grow")
            if not writes:
                ui.label("read only: controls need the address with the token").classes("note").props('data-name="read-only"')
            ui.html(MENU.format(id="view", label="View"), sanitize=False)
            ui.html(PAUSE, sanitize=False, tag="label").classes("pause")
            if writes:
                button("Emergency stop", graph.emergency_stop, "dense color=negative")
        with ui.element("div").classes("programme") as self._programme:
            self._programme_text = ui.label("").props('data-name="programme"')
            if writes:
                self._requests = {
                    request: button(text, partial(graph.programme, request), "dense outline")
                    for request, text in PROGRAMME_BUTTONS.items()
                }
        lost = "The dashboard's server does not answer: it was stopped, the connection is lost, or the machine is too busy."
        # The row has a fixed height; a longer text covers the plots, so that nothing moves under the pointer.
        with ui.element("div").classes("notices"):
            with ui.element("div").classes("trouble") as self._trouble:
                self._text = ui.label("").props('data-name="trouble"')
                if writes:
                    remedies = {
                        Remedy.ACKNOWLEDGE: graph.acknowledge_stop,
                        Remedy.UNLOAD: graph.unload,
                        Remedy.RESET: graph.reset_and_enable,
                        Remedy.ENABLE: graph.enable,
                    }
                    self._remedies = {
                        remedy: button(remedy.value, ask, "dense color=negative") for remedy, ask in remedies.items()
                    }
            ui.label(lost).classes("trouble lost")

    def _side(self, spec: Path | None, timing: Timing, *, writes: bool) -> None:
        names = ("Tune", "Experiment", "Nodes", "Rig") if writes else ("Nodes", "Rig")
        with ui.tabs().props("dense no-caps align=justify") as tabs:
            made = {name: ui.tab(name).props(f'data-name="tab-{name.lower()}"') for name in names}
        with ui.tab_panels(tabs, value=made[names[0]], animated=False, keep_alive=True):
            if writes:
                with ui.tab_panel(made["Experiment"]):
                    self._experiment = ExperimentTab(self._graph, spec, timing)
                with ui.tab_panel(made["Tune"]):
                    self._tuning_section = TuningSection(self._graph, self._experiment)
                    self._tuning = TuningTab(self._graph)
            with ui.tab_panel(made["Nodes"]):
                self._nodes = NodesTab()
            with ui.tab_panel(made["Rig"]):
                self._rig = RigTab(self._graph, made["Rig"], writes=writes)

    def _send_plots(self) -> None:
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

    async def _send_texts(self) -> None:
        self._show_texts()
        if self._tuning is not None:
            await self._tuning.follow(self._era, self._applications)

    def _show_texts(self) -> None:
        snapshot = self._graph.snapshot()
        status = status_of(snapshot, graph_seen=self._graph_seen)
        self._graph_seen |= snapshot.rate > 0.0
        self._state.set_text(status.text)
        _set_level(self._state, status.level)
        figures = programme_figures(snapshot.health)
        self._programme_text.set_text(programme_line(figures))
        self._programme.set_visibility(bool(figures))
        possible = programme_requests(figures)
        for request, pressed in self._requests.items():
            pressed.set_enabled(request in possible)
        self._text.set_text(status.trouble)
        self._trouble.set_visibility(bool(status.trouble))
        self._trouble.classes(
            add="bad" if status.level > WARNING else "warn", remove="warn" if status.level > WARNING else "bad"
        )
        for remedy, pressed in self._remedies.items():
            pressed.set_visibility(remedy is status.remedy)
        self._start_card.show(snapshot.starting, graph_seen=self._graph_seen)
        self._nodes.show(snapshot.health)
        self._rig.show(snapshot.rig)
        if self._experiment is not None:
            self._experiment.show(snapshot)
        if self._tuning_section is not None:
            self._tuning_section.show(snapshot)
        self._applications = snapshot.tuning.applications if snapshot.tuning is not None else 0


class StartCard:
    """Card shown until a graph has been seen, and again while another one is being started."""

    def __init__(self, graph: Graph, *, writes: bool) -> None:
        """Build the card in the current slot.

        Args:
            graph: the graph to be started.
            writes: whether the page has a Start button.
        """
        self._none = f"Looking in {graph.where}. {NO_GRAPH_TEXT_WITH_CONTROLS if writes else NO_GRAPH_TEXT}"
        with ui.element("section").classes("beginning").props('data-name="beginning"') as self._card:
            self._title = ui.label("").classes("title")
            self._nodes = ui.html("", sanitize=False, tag="dl")
            self._text = ui.label("").classes("note")

    def show(self, progress: StartProgress | None, *, graph_seen: bool) -> None:
        """Update the card.

        Args:
            progress: progress of the nodes, if any are being started.
            graph_seen: whether the plots have anything to show.
        """
        self._card.set_visibility(progress is not None or not graph_seen)
        self._title.set_text(f"Starting the graph: {progress.seconds:.0f} s" if progress else "No graph is running")
        self._nodes.set_visibility(progress is not None)
        rows = progress.nodes.items() if progress else ()
        self._nodes.set_content("".join(f"<dt>{escape(node)}</dt><dd>{escape(stage)}</dd>" for node, stage in rows))
        self._text.set_text(COMPILING_TEXT if progress else self._none)


class NodesTab:
    """Each node's diagnostics; its values unfold on a click."""

    def __init__(self) -> None:
        """Build the tab in the current slot."""
        self._none = ui.label("No node publishes diagnostics.").classes("note")
        self._list = ui.element("div").classes("nodes")
        self._rows: dict[str, _Row] = {}

    def show(self, health: tuple[NodeHealth, ...]) -> None:
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
                self._message = ui.label("").classes("note")
            self._figures = ui.html("", sanitize=False, tag="dl")

    def show(self, health: NodeHealth) -> None:
        self._level.set_text(LEVELS[health.level])
        _set_level(self._level, health.level)
        self._message.set_text(health.message)
        cells = (f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in health.figures.items())
        self._figures.set_content("".join(cells))


def _set_level(badge: ui.label, level: int) -> None:
    badge.classes(add=f"level-{level}", remove=" ".join(f"level-{i}" for i in range(len(LEVELS)) if i != level))


def _plot(panel: Panel) -> dict[str, Any]:
    """Make an empty plot, and return the settings with which the browser fills it."""
    with ui.element("section").classes("plot wide" if panel.wide else "plot"):
        head = ui.html("", sanitize=False, tag="header")
        chart = ui.echart(options(panel))
    legend = f'<span class="legend" id="legend-{chart.id}"></span>'
    menu = MENU.format(id=f"signals-{chart.id}", label="+")
    head.set_content(f'<b id="title-{chart.id}">{escape(panel.title)}</b>{legend}{menu}')
    return {"id": chart.id, "title": panel.title, "unit": panel.unit, "signals": panel.signals}


def _columns(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return one row per signal; single precision is enough for a plot."""
    return np.ascontiguousarray(values.T, dtype=np.float32)


def _json(content: Any) -> str:
    """Return JSON that is safe inside a script element; NaN and infinity become null."""
    return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY).decode().replace("</", "<\\/")
