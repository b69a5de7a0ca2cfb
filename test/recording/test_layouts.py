"""Every path in the layouts for Foxglove and PlotJuggler is a field of a published message."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.nodes.frames import BASE
from ehls_ros.recording.topics import TOPICS
from ehls_ros.trajectory import SIGNALS

ROOT = Path(__file__).resolve().parents[2]
LAYOUTS = ROOT / "config" / "layouts"
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


def panels() -> dict[str, Any]:
    return dict(json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))["configById"])


def curves() -> list[str]:
    """Return the sources of PlotJuggler's curves; for an equation the curve it is computed from."""
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    sources = {snippet.attrib["name"]: snippet.findtext("linked_source") for snippet in root.iter("snippet")}
    return [sources.get(curve.attrib["name"]) or curve.attrib["name"] for curve in root.iter("curve")]


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
