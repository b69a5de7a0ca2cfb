"""What tests read out of a report's page."""

import base64
import json
import re

import numpy as np


def panels(html):
    """Title, traces and layout of every figure; a number JSON does not know is an error, as in a browser."""

    def refuse(constant):
        raise ValueError(constant)

    pattern = r'<h2>(.*?)</h2>.*?<script type="application/json">(.*?)</script>'
    found = [(title, json.loads(text, parse_constant=refuse)) for title, text in re.findall(pattern, html, re.DOTALL)]
    return {title: (figure["data"], figure["layout"]) for title, figure in found}


def numbers(array):
    if isinstance(array, list):
        return np.array([np.nan if value is None else value for value in array])
    return np.frombuffer(base64.b64decode(array["bdata"]), "<f4")


def drawn_axes(layout):
    return {
        name: axis for name, axis in layout.items() if re.fullmatch(r"[xy]axis\d*", name) and axis.get("visible") is not False
    }


def check(html):
    """What must hold of every figure of every report."""
    for title, (traces, layout) in panels(html).items():
        for name, axis in drawn_axes(layout).items():
            assert re.search(r"\[[^\]]+\]$", axis["title"]["text"]), f"{title}: {name} has no unit"
        for trace in traces:
            assert trace.get("yaxis", "y").replace("y", "yaxis") in layout, f"{title}: no axis for {trace.get('name')}"
        shown = [trace for trace in traces if trace.get("hoverinfo") != "skip"]
        assert any(np.isfinite(numbers(trace["y"])).any() for trace in shown), f"{title} is empty"
