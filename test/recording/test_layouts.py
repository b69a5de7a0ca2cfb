"""The layouts match the formats of Foxglove, Lichtblick and PlotJuggler, and every path is a field of a published message.

test/nodes/test_experiment_over_dds.py compares the paths with a bag of the whole graph.
"""

import dataclasses
import json
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from layouts import LAYOUTS, ROOT, curves, panels

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.nodes.frames import BASE
from ehls_ros.recording.topics import ACTUATOR_TOPICS, CYCLE_TOPICS, PROGRAMME_POINT, TOPICS
from ehls_ros.trajectory import SIGNALS

FIELD = re.compile(r"^(?P<type>\w+(?P<many>\[\])?)\s+(?P<name>\w+)", re.MULTILINE)
WANTED = {
    "force_n",
    "force_reference_n",
    "force_error_n",
    "force_bound_n",
    "load_pressure_pa",
    "spool_m",
    "valve_command_m",
    "friction_elements_n",
    "alpha",
    "beta",
    "delta_n",
    "position_m",
    "velocity_m_s",
    "disturbance_force_n",
    "oil_temperature_k",
}
"""Signals that the layouts must show."""

Path_ = tuple[str, str]
"""Topic below its namespace, and field."""


def fields(message: str) -> dict[str, bool]:
    """Return the fields of a message of ehls_msgs, and whether they are sequences."""
    text = (ROOT / "ehls_msgs" / "msg" / f"{message}.msg").read_text(encoding="utf-8")
    return {match["name"]: match["many"] is not None for match in FIELD.finditer(text)}


PLOTTED: dict[Path_, bool] = {
    (topic.name, name): many
    for topic in TOPICS
    if topic.type.startswith("ehls_msgs/")
    for name, many in fields(topic.type.rpartition("/")[2]).items()
}
"""Fields that can be plotted, and whether they are sequences."""


def signal_at(path: str, namespace: str, separator: str) -> str:
    """Return the signal that a path shows; fail if there is none."""
    match = re.fullmatch(rf"{namespace}/(\w+){separator}(\w+)(\[\d\])?", path)
    assert match, path
    topic, field, element = match.groups()
    assert (topic, field) in PLOTTED, path
    assert PLOTTED[topic, field] == (element is not None), path
    [signal] = [t.signals[field] for t in TOPICS if t.name == topic]
    return signal


def test_every_path_of_the_foxglove_layout_is_a_field():
    shown = set()
    for panel in panels().values():
        for entry in panel.get("paths", []):
            path = entry["value"].removesuffix(".@negative")
            signal = signal_at(path, "/(?:ehls|sim)", r"\.")
            assert panel["yAxisLabel"] == SIGNALS[signal].unit, path
            if path.startswith("/ehls/"):
                shown.add(signal)
    assert shown >= WANTED


TITLE = "foxglovePanelTitle"
LICHTBLICK_TITLE = "lichtblickPanelTitle"
"""Keys of a panel's heading in the two programs; a plain `title` is read by neither."""


def keys_of(kind: Any) -> set[str]:
    """Return the keys written by a class of Foxglove's layout library."""
    required = {field.name: None for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING}
    return set(kind(**required)._to_dict())


def test_every_key_of_the_foxglove_layout_is_one_that_foxglove_knows():
    known = pytest.importorskip("foxglove.layouts", reason="needs the extra `foxglove`")
    kinds = {"Plot": known.PlotConfig, "DiagnosticSummary": known.DiagnosticsSummaryConfig, "3D": known.ThreeDeeConfig}
    for name, panel in panels().items():
        assert panel.keys() - {TITLE, LICHTBLICK_TITLE} <= keys_of(kinds[name.partition("!")[0]]), name
        assert all(path.keys() <= keys_of(known.PlotSeries) for path in panel.get("paths", [])), name
    rig = panels()["3D!rig"]
    assert rig["cameraState"].keys() <= keys_of(known.ThreeDeeCameraState)
    assert all(layer.keys() <= keys_of(known.BaseRendererUrdfLayerSettings) for layer in rig["layers"].values())


LICHTBLICK = {
    "Plot": {
        "paths", "minXValue", "maxXValue", "minYValue", "maxYValue", "showLegend", "legendDisplay", "showPlotValuesInLegend",
        "showXAxisLabels", "showYAxisLabels", "isSynced", "xAxisVal", "xAxisPath", "xAxisLabel", "yAxisLabel",
        "followingViewWidth", "sidebarDimension",
    },
    "DiagnosticSummary": {
        "minLevel", "pinnedIds", "topicToRender", "hardwareIdFilter", "sortByLevel", "secondsUntilStale",
    },
    "3D": {"cameraState", "followTf", "followMode", "scene", "publish", "transforms", "topics", "layers", "imageMode"},
}  # fmt: skip
"""Keys of a panel's configuration in Lichtblick 1.28, the free successor of Foxglove Studio: PlotConfig in
panels/Plot/utils/config.ts, DiagnosticSummaryConfig in panels/DiagnosticSummary/types.ts, RendererConfig in
panels/ThreeDeeRender/IRenderer.ts."""


def test_every_key_of_the_foxglove_layout_is_one_that_lichtblick_knows():
    for name, panel in panels().items():
        assert panel.keys() - {TITLE, LICHTBLICK_TITLE} <= LICHTBLICK[name.partition("!")[0]], name
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    assert layout.keys() <= {"configById", "layout", "globalVariables", "playbackConfig", "userNodes", "version"}


def test_panels_are_headed_with_their_unit_in_both_programs():
    for panel in panels().values():
        assert panel[TITLE] == panel[LICHTBLICK_TITLE]
        if "yAxisLabel" in panel:
            assert panel[TITLE].endswith(f"[{panel['yAxisLabel']}]")


def test_every_topic_of_the_cycles_is_in_both_layouts():
    # Most runs have no programme, which the dashboard shows, and no companion that uses the actuator's command.
    cycles = {topic.name for topic in CYCLE_TOPICS if topic not in (PROGRAMME_POINT, *ACTUATOR_TOPICS.values())}
    paths = {path["value"] for panel in panels().values() for path in panel.get("paths", [])}
    assert cycles <= {path.split("/")[2].partition(".")[0] for path in paths if path.startswith("/ehls/")}
    assert cycles <= {curve.split("/")[2] for curve in curves() if curve.startswith("/ehls/")}


def test_the_foxglove_layout_shows_diagnostics_and_every_panel_it_describes():
    described = panels()
    assert described["DiagnosticSummary!diagnostics"]["topicToRender"] in {topic.name for topic in TOPICS}

    def placed(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        else:
            yield from placed(node["first"])
            yield from placed(node["second"])

    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))["layout"]
    assert sorted(placed(layout)) == sorted(described)


def test_the_foxglove_layout_draws_the_rig_in_its_own_frames():
    rig = panels()["3D!rig"]
    assert rig["followTf"] == BASE
    assert [(layer["sourceType"], layer["topic"]) for layer in rig["layers"].values()] == [("topic", "/ehls/robot_description")]


PLOTJUGGLER = {
    "root": set(),
    "tabbed_widget": {"name", "parent"},
    "Tab": {"tab_name", "containers"},
    "Container": set(),
    "DockSplitter": {"orientation", "count", "sizes"},
    "DockArea": {"name"},
    "plot": {"mode", "style", "flip_x", "flip_y"},
    "limitY": {"min", "max"},
    "curve": {"name", "color"},
    "currentTabIndex": {"index"},
    "use_relative_time_offset": {"enabled"},
    "customMathEquations": set(),
    "snippet": {"name", "language"},
    "global": set(),
    "function": set(),
    "linked_source": set(),
}
"""Elements and attributes that PlotJuggler 3.16 reads: xmlLoadState in mainwindow.cpp, tabbedplotwidget.cpp, plot_docker.cpp,
and plotwidget.cpp, GetSnippetFromXML in custom_function.cpp."""


def test_every_element_of_the_plotjuggler_layout_is_one_that_plotjuggler_knows():
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    for element in root.iter():
        assert set(element.attrib) <= PLOTJUGGLER[element.tag], element.tag
    assert [widget.attrib for widget in root.iter("tabbed_widget")] == [{"name": "Main Window", "parent": "main_window"}]
    for splitter in root.iter("DockSplitter"):
        # PlotJuggler reads as many splits, sizes and children as the count states.
        assert {len(splitter), len(splitter.attrib["sizes"].split(";"))} == {int(splitter.attrib["count"])}
        assert splitter.attrib["orientation"] in {"-", "|"}
    for plot in root.iter("plot"):
        assert (plot.attrib["mode"], plot.attrib["style"]) == ("TimeSeries", "Lines")
    assert all(re.fullmatch(r".+ \[.+\]", area.attrib["name"]) for area in root.iter("DockArea")), "a plot without unit"


def test_every_curve_of_the_plotjuggler_layout_is_a_field():
    messages = [curve for curve in curves() if not curve.startswith("/diagnostics/")]
    assert {signal_at(curve, "/ehls", "/") for curve in messages} >= WANTED


@pytest.mark.parametrize("curve", [curve for curve in curves() if curve.startswith("/diagnostics/")])
def test_the_diagnostics_of_the_plotjuggler_layout_are_those_of_a_node(curve):
    """PlotJuggler names them by topic, hardware id, node and key."""
    _, topic, hardware, node, key = curve.split("/")
    assert (topic, hardware) == ("diagnostics", "ehls")
    assert node in {"plant_sim_node", *(f"{name}_node" for name in CONTROLLERS.names())}
    said = [ROOT / "ehls_ros" / "nodes" / f"{name}.py" for name in ("latency", "plant", "controller")]
    assert any(f'"{key}"' in file.read_text(encoding="utf-8") for file in said)
