"""Parsers of a report's page for tests."""

import base64
import html
import json
import re
import time

import numpy as np


def figures(text):
    """Return title, traces and layout of every figure; a number unknown to JSON is an error, as in a browser."""

    def refuse(constant):
        raise ValueError(constant)

    pattern = r'<h2>(.*?)</h2>.*?<script type="application/json">(.*?)</script>'
    found = [(title, json.loads(described, parse_constant=refuse)) for title, described in re.findall(pattern, text, re.DOTALL)]
    return [(title, figure["data"], figure["layout"]) for title, figure in found]


def panels(text):
    """Return traces and layout of every figure by its title."""
    return {title: (traces, layout) for title, traces, layout in figures(text)}


def numbers(array):
    if isinstance(array, list):
        return np.array([np.nan if value is None else value for value in array])
    return np.frombuffer(base64.b64decode(array["bdata"]), "<f4")


def drawn_axes(layout):
    return {
        name: axis for name, axis in layout.items() if re.fullmatch(r"[xy]axis\d*", name) and axis.get("visible") is not False
    }


def check(text):
    """Check the invariants of every figure of every report."""
    for title, traces, layout in figures(text):
        for name, axis in drawn_axes(layout).items():
            counts = "ticktext" in axis
            assert bool(re.search(r"\[[^\]]+\]$", axis["title"]["text"])) != counts, f"{title}: {name} has no unit"
        for trace in traces:
            assert trace.get("yaxis", "y").replace("y", "yaxis") in layout, f"{title}: no axis for {trace.get('name')}"
        shown = [trace for trace in traces if trace.get("hoverinfo") != "skip"]
        assert any(np.isfinite(numbers(trace["y"])).any() for trace in shown), f"{title} is empty"


def parts(text):
    """Return the headings of the parts, in order."""
    return re.findall(r'<h2 class="part"[^>]*>(.*?)</h2>', html.unescape(text))


def rows(text, part):
    """Return the rows of the tables of one part, a list of texts each; the second line of a cell follows after a bar."""
    start = text.index(f">{html.escape(part)}</h2>")
    end = text.find('<h2 class="part"', start)
    found = re.findall(r"<tr>(.*?)</tr>", text[start:end])
    return [
        [
            re.sub(r"<[^>]+>", "", cell.replace("<small>", " | "))
            for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", html.unescape(row))
        ]
        for row in found
    ]


def row(text, part, name):
    """Return the row of that name."""
    return next(cells for cells in rows(text, part) if cells[0].split(" | ")[0] == name)


def effort(work):
    """Return the result of some work and its processor time [s], which is nearly the same on an idle or a busy machine."""
    begin = time.process_time()
    given = work()
    return given, time.process_time() - begin
