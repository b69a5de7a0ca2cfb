"""Figures of a campaign's report: each function takes the results and returns a panel."""

from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.experiments.campaign.plan import Column
from ehls_ros.experiments.campaign.results import CampaignResults
from ehls_ros.report import plot
from ehls_ros.report.campaign_findings import Group, correlations
from ehls_ros.report.page import Panel, plane
from ehls_ros.report.plot import NEWTON, PURE_NUMBER, Axis, Trace, Unit

COLORS = (plot.BLUE, plot.VERMILION, plot.GREEN, plot.ORANGE, plot.PURPLE, plot.SKY, plot.BLACK, plot.GREY)
PERCENT = Unit("%", 100.0)
SYMBOLS = ("circle", "diamond", "square", "triangle-up")
ROW_HEIGHT = 22
"""Height of a named row [pixels]."""


def _color(index: int) -> str:
    return COLORS[index % len(COLORS)]


def _error_axis(errors: Array) -> Axis:
    return Axis("largest error", NEWTON, plot.decades(errors), logarithmic=True)


def _value_axis(column: Column, values: Array) -> Axis:
    """Return the axis of a parameter, logarithmic if it varies over about a decade or more."""
    unit = Unit(column.unit or PURE_NUMBER.symbol)
    known = values[np.isfinite(values)]
    if known.size and known.min() > 0 and known.max() > 8 * known.min():
        return Axis(column.path, unit, plot.decades(known), logarithmic=True)
    return Axis(column.path, unit)


def distribution(results: CampaignResults, groups: Sequence[Group]) -> Panel:
    """Draw the cumulative distribution of the largest error, one line per group."""
    errors = results.max_error_n
    traces: list[Trace] = []
    for index, group in enumerate(groups):
        known = np.sort(errors[group.rows][np.isfinite(errors[group.rows])])
        # Runs without an error count as well, so that the line ends below 100 %.
        share = np.arange(1, known.size + 1) / group.rows.size
        if known.size:
            trace = plot.line(known, share, group.name, PERCENT, _color(index), width=2.0)
            trace["line"] = {"color": _color(index), "width": 2.0, "shape": "hv"}
            traces.append(trace)
    note, share_axis = "Fraction of the runs with no larger error.", Axis("fraction of runs", PERCENT, (0.0, 101.0))
    return _panel("Distribution of the largest error", traces, _error_axis(errors), share_axis, note, 360, len(traces))


def _panel(title: str, traces: Sequence[Trace], x: Axis, y: Axis, note: str, height: int, entries: int) -> Panel:
    """Return a figure with a legend of long names above it, one line each."""
    panel = plane(title, traces, x, y, note, height, legend={"x": 0, "xanchor": "left", "y": 1.0, "yanchor": "bottom"})
    panel.layout["margin"] |= {"t": 26 + 19 * max(entries - 1, 0)}
    return panel


def influence(results: CampaignResults, columns: Sequence[Column], groups: Sequence[Group]) -> Panel:
    """Draw the rank correlation of the largest error with each drawn parameter, one mark per group."""
    found = [correlations(results, columns, group) for group in groups]
    strength = np.nan_to_num(np.max(np.abs(np.nan_to_num(found)), axis=0))
    order = np.argsort(strength)
    at = np.arange(1.0, len(columns) + 1.0)
    traces = [
        plot.dots(found[index][order], at, group.name, PURE_NUMBER, _color(index), symbol=SYMBOLS[index % len(SYMBOLS)])
        | {"hovertemplate": "%{x:.2f}"}
        for index, group in enumerate(groups)
    ]
    names = tuple(columns[i].path for i in order)
    x = Axis("rank correlation with the largest error", PURE_NUMBER, (-1.05, 1.05))
    y = Axis("parameter", PURE_NUMBER, (0.3, len(columns) + 0.7), names=names)
    height = 150 + ROW_HEIGHT * len(columns) + 19 * len(groups)
    note = "+1: the error grows with the parameter; 0: no relation."
    return _panel("Correlation with the largest error", traces, x, y, note, height, len(groups))


def scatter(results: CampaignResults, column: Column, groups: Sequence[Group]) -> Panel:
    """Draw the largest error of every run against a drawn parameter."""
    errors, values = results.max_error_n, results.numbers[column.path]
    traces = [
        plot.dots(values[group.rows], errors[group.rows], group.name, NEWTON, _color(index), size=3)
        for index, group in enumerate(groups)
    ]
    x, y = _value_axis(column, values), _error_axis(errors)
    return _panel(column.path, traces, x, y, "", 340 + 19 * len(groups), len(groups))


def sweep(results: CampaignResults, column: Column, groups: Sequence[Group]) -> Panel:
    """Draw the median of the largest error against a swept parameter, with the smallest and the largest."""
    errors, values = results.max_error_n, results.numbers[column.path]
    traces: list[Trace] = []
    for index, group in enumerate(groups):
        error, value = errors[group.rows], values[group.rows]
        at = np.unique(value)
        known = [error[(value == one) & np.isfinite(error)] for one in at]
        for take, dash, width in ((np.median, "solid", 2.0), (np.min, "dot", 1.0), (np.max, "dot", 1.0)):
            levels = np.array([take(one) if one.size else np.nan for one in known])
            trace = plot.line(at, levels, group.name, NEWTON, _color(index), width=width, dash=dash)
            traces.append(trace if dash == "solid" else trace | plot.SILENT)
    note = "Median over all other varied values; dotted: smallest and largest."
    x, y = _value_axis(column, values), _error_axis(errors)
    return _panel(column.path, traces, x, y, note, 320 + 19 * len(groups), len(groups))


def heat_map(results: CampaignResults, across: Column, up: Column, group: Group) -> Panel:
    """Draw the median of the largest error over two swept parameters."""
    errors = results.max_error_n[group.rows]
    x, y = (results.numbers[column.path][group.rows] for column in (across, up))
    columns, rows = np.unique(x), np.unique(y)
    median = np.full((rows.size, columns.size), np.nan)
    for i, row in enumerate(rows):
        for j, value in enumerate(columns):
            here = errors[(x == value) & (y == row) & np.isfinite(errors)]
            if here.size:
                median[i, j] = np.median(here)
    with np.errstate(divide="ignore"):
        shade = np.log10(median)
    low, high = plot.decades(median.ravel())
    marks = [step * 10.0**decade for decade in range(int(np.floor(np.log10(low))), 12) for step in (1, 2, 5)]
    marks = [mark for mark in marks if low <= mark <= high]
    bar = {"title": {"text": f"largest error [{NEWTON.symbol}]", "side": "right"}, "thickness": 14}
    trace: Trace = {
        "type": "heatmap",
        "x": plot.packed(columns),
        "y": plot.packed(rows),
        "z": plot.packed(shade),
        "customdata": plot.packed(median),
        "colorscale": "Viridis",
        "colorbar": bar | {"tickvals": np.log10(marks).tolist(), "ticktext": [f"{mark:g}" for mark in marks]},
        "name": group.name,
        "hovertemplate": f"%{{x:.4~g}}, %{{y:.4~g}}: %{{customdata:,.4~g}} {NEWTON.symbol}<extra></extra>",
    }
    axes = _value_axis(across, x), _value_axis(up, y)
    return plane(f"{across.path} and {up.path}", [trace], *axes, f"Median; {group.name}.", 380, showlegend=False)
