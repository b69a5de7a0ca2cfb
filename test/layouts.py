"""The layouts for Foxglove and PlotJuggler."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

ROOT = Path(__file__).resolve().parents[1]
LAYOUTS = ROOT / "config" / "layouts"


def panels() -> dict[str, Any]:
    """Return the configurations of Foxglove's panels by name."""
    return dict(json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))["configById"])


def curves() -> list[str]:
    """Return the sources of PlotJuggler's curves; for an equation, the curve it is computed from."""
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    sources = {snippet.attrib["name"]: snippet.findtext("linked_source") for snippet in root.iter("snippet")}
    return [sources.get(curve.attrib["name"]) or curve.attrib["name"] for curve in root.iter("curve")]


def series() -> set[str]:
    """Return all series of a recording that the layouts show, as PlotJuggler names them."""
    paths = {path["value"] for panel in panels().values() for path in panel.get("paths", [])}
    recorded = {path.removesuffix(".@negative").replace(".", "/") for path in paths if path.startswith("/ehls/")}
    return recorded | set(curves())
