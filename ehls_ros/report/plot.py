"""Elements of the figures: units, colours, lines and axes as plain plotly dictionaries.

Plotly's Python objects are not used: building and checking them would take longer than the rest of a report.
"""

import base64
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report.decimation import BUCKETS, kept_samples

Trace = dict[str, Any]
Layout = dict[str, Any]

BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE = "#0072B2", "#D55E00", "#009E73", "#B85C92", "#56B4E9", "#E69F00"
BLACK, GREY, LIGHT_GREY = "#1a1a1a", "#767676", "#dcdcdc"
"""Colours of Okabe and Ito, distinguishable by colour-blind readers."""

ELEMENT_LINES = ((BLUE, "solid"), (ORANGE, "solid"), (GREEN, "dash"), (SKY, "solid"), (PURPLE, "dash"))
"""Colour and pattern of each friction element's line."""

FONT = "system-ui, -apple-system, 'Segoe UI', 'Liberation Sans', 'DejaVu Sans', sans-serif"
BACKDROP = "y9"
"""Axis from 0 to 1 behind the first row, for marks of a time instead of a value."""

SILENT = {"showlegend": False, "hoverinfo": "skip", "hovertemplate": None}
"""Keys of a trace without an entry in the legend and without a value under the cursor."""


class Unit(NamedTuple):
    """Unit in which quantities are shown.

    Attributes:
        symbol: as printed.
        factor: factor from the trajectory's unit to this one.
    """

    symbol: str
    factor: float = 1.0


NEWTON, KILONEWTON = Unit("N"), Unit("kN", 1e-3)
MILLIMETRE, MILLIMETRE_PER_SECOND = Unit("mm", 1e3), Unit("mm/s", 1e3)
MEGAPASCAL, MEGAPASCAL_PER_SECOND = Unit("MPa", 1e-6), Unit("MPa/s", 1e-6)
PAPER_PRESSURE_RATE = Unit("MPa/s")
SECOND, MICROSECOND = Unit("s"), Unit("µs", 1e6)
CYCLES, PURE_NUMBER = Unit("cycles"), Unit("–")


class Axis(NamedTuple):
    """An axis of a figure.

    Attributes:
        quantity: quantity shown.
        unit: unit shown.
        span: lowest and highest value shown, in that unit; None to fit the data.
        share: height relative to the other rows of the figure.
        logarithmic: whether the axis is logarithmic; needs a span.
        names: labels of 1, 2, 3, … on a categorical axis, which shows no unit.
    """

    quantity: str
    unit: Unit
    span: tuple[float, float] | None = None
    share: float = 1.0
    logarithmic: bool = False
    names: tuple[str, ...] = ()


VELOCITY, FRICTION = Axis("velocity", MILLIMETRE_PER_SECOND), Axis("friction", NEWTON)


def shade(color: str, opacity: float) -> str:
    """Return a colour such as "#0072B2" with an opacity, for areas."""
    red, green, blue = bytes.fromhex(color[1:])
    return f"rgba({red}, {green}, {blue}, {opacity:g})"


def packed(values: NDArray[Any]) -> dict[str, str]:
    """Encode numbers in the fastest format for plotly.js: base64 of single precision, NaN for a gap.

    Args:
        values: shape (n,) or (rows, columns).

    Returns:
        Plotly's description of a typed array.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        single = np.asarray(values).astype("<f4")
    single[~np.isfinite(single)] = np.nan
    shape = {"shape": ", ".join(map(str, single.shape))} if single.ndim > 1 else {}
    return {"dtype": "f4", "bdata": base64.b64encode(single.tobytes()).decode("ascii"), **shape}


def scatter(mode: str, x: object, y: object, name: str, *, row: int = 1, **style: object) -> Trace:
    """Return a trace of points, lines or both.

    Args:
        mode: plotly's "lines", "markers" or both.
        x: abscissa as shown.
        y: ordinate as shown.
        name: entry in the legend.
        row: row of the figure, 1 on top.
        style: further keys of plotly's trace.
    """
    axis = "y" if row == 1 else f"y{row}"
    return {"type": "scatter", "mode": mode, "x": x, "y": y, "yaxis": axis, "name": name} | style


def line(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    name: str,
    unit: Unit,
    color: str,
    *,
    row: int = 1,
    width: float = 1.5,
    dash: str = "solid",
) -> Trace:
    """Draw every sample of y against x.

    Args:
        x: abscissa as shown, shape (n,).
        y: ordinate in the trajectory's unit, shape (n,), NaN where the line is interrupted.
        name: entry in the legend.
        unit: unit to show y in.
        color: colour of the line.
        row: row of the figure, 1 on top.
        width: line width in pixels.
        dash: plotly's name of the pattern.

    Returns:
        A plotly trace, with dots as well if there are isolated samples, which a line cannot show.
    """
    known = np.concatenate([[False], np.isfinite(y), [False]])
    alone = bool(np.any(known[1:-1] & ~known[:-2] & ~known[2:]))
    style = {"line": {"color": color, "width": width, "dash": dash}, "marker": {"color": color, "size": 4}}
    hover = f"%{{y:,.5~g}} {unit.symbol}"
    mode = "lines+markers" if alone else "lines"
    return scatter(mode, packed(x), packed(y * unit.factor), name, row=row, **style, hovertemplate=hover)


def time_line(
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    name: str,
    unit: Unit,
    color: str,
    *,
    row: int = 1,
    width: float = 1.5,
    dash: str = "solid",
    buckets: int = BUCKETS,
) -> Trace:
    """Draw a signal over time with as many samples as the figure can show.

    Args:
        time: time since the start, shape (n,) [s].
        values: the signal in the trajectory's unit, shape (n,), NaN in gaps.
        name: entry in the legend.
        unit: unit to show it in.
        color: colour of the line.
        row: row of the figure, 1 on top.
        width: line width in pixels.
        dash: plotly's name of the pattern.
        buckets: number of intervals to which a long series is reduced; fewer on a page with many small figures.

    Returns:
        A plotly trace.
    """
    kept = kept_samples(values, buckets)
    return line(time[kept], values[kept], name, unit, color, row=row, width=width, dash=dash)


def band(time: NDArray[np.float64], half_width: NDArray[np.float64], name: str, unit: Unit, *, row: int = 1) -> list[Trace]:
    """Shade the region between plus and minus a bound.

    Args:
        time: time since the start, shape (n,) [s].
        half_width: the bound in the trajectory's unit, shape (n,); gaps are bridged.
        name: entry in the legend.
        unit: unit to show it in.
        row: row of the figure, 1 on top.

    Returns:
        Two plotly traces, the lower and the upper edge.
    """
    known = np.isfinite(half_width)
    lower = time_line(time[known], -half_width[known], name, unit, GREY, row=row, width=0.8)
    upper = time_line(time[known], half_width[known], name, unit, GREY, row=row, width=0.8)
    fill = {"fill": "tonexty", "fillcolor": shade(GREEN, 0.16)}
    return [lower | SILENT, upper | fill]


def region(
    x: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    name: str,
    unit: Unit,
    color: str,
    opacity: float,
) -> Trace:
    """Shade the region between two curves, without an outline.

    Args:
        x: abscissa as shown, shape (n,).
        low: lower curve before conversion, shape (n,).
        high: upper curve before conversion, shape (n,).
        name: entry in the legend.
        unit: unit to show y in.
        color: colour of the area.
        opacity: opacity of the area.
    """
    outline = packed(np.concatenate([x, x[::-1]])), packed(np.concatenate([low, high[::-1]]) * unit.factor)
    fill = shade(color, opacity)
    return scatter("lines", *outline, name, fill="toself", fillcolor=fill, line={"width": 0}, hoverinfo="skip")


def bars(x: object, y: object, name: str, color: str, hover: str, **style: object) -> Trace:
    """Draw bars.

    Args:
        x: abscissa as shown, or the lengths of horizontal bars.
        y: lengths as shown, or the ordinate of horizontal bars.
        name: entry in the legend.
        color: colour of the bars.
        hover: plotly's template of the value under the cursor.
        style: further keys of plotly's trace.
    """
    return {"type": "bar", "x": x, "y": y, "name": name, "marker": {"color": color}, "hovertemplate": hover, **style}


def limits(time: NDArray[np.float64], value: NDArray[np.float64], name: str, unit: Unit) -> list[Trace]:
    """Draw plus and minus a limit as dashed lines.

    Args:
        time: time since the start, shape (n,) [s].
        value: the limit in the trajectory's unit, shape (n,).
        name: entry in the legend.
        unit: unit to show it in.

    Returns:
        Two plotly traces with one entry in the legend.
    """
    upper = time_line(time, value, name, unit, GREY, width=1.2, dash="dash") | {"legendgroup": name}
    lower = time_line(time, -value, name, unit, GREY, width=1.2, dash="dash") | {"legendgroup": name}
    return [upper, lower | SILENT]


def event_marks(time: NDArray[np.float64], happened: NDArray[np.bool_], name: str, color: str) -> list[Trace]:
    """Mark the times of an event with ticks along the upper edge.

    Args:
        time: time since the start, shape (n,) [s].
        happened: shape (n,).
        name: entry in the legend; the number of samples is added.
        color: colour of the ticks.

    Returns:
        One plotly trace, or none without an event.
    """
    at = time[happened]
    if not at.size:
        return []
    distinct = np.unique((at / max(time[-1], 1e-9) * BUCKETS).astype(np.int64), return_index=True)[1]
    marker = {"symbol": "line-ns-open", "size": 9, "color": color, "line": {"width": 1.6, "color": color}}
    label = f"{name} ({at.size:,})".replace(",", "\u202f")
    marks = scatter("markers", packed(at[distinct]), packed(np.full(distinct.size, 0.965)), label, marker=marker)
    return [marks | {"yaxis": BACKDROP, "hoverinfo": "skip"}]


def time_mark(at: float, name: str, color: str = BLACK, dash: str = "dot") -> Trace:
    """Draw a vertical line at a time through all rows, explained in the legend.

    Args:
        at: time since the start [s].
        name: entry in the legend.
        color: colour of the line.
        dash: plotly's name of the pattern.
    """
    return upright(at, (0.0, 1.0), name, color, width=1.3, dash=dash) | {"yaxis": BACKDROP}


def upright(
    at: float, span: tuple[float, float], name: str, color: str = BLACK, *, width: float = 1.8, dash: str = "dot"
) -> Trace:
    """Draw a vertical line in the first row, explained in the legend.

    Args:
        at: abscissa as shown.
        span: lower and upper end as shown.
        name: entry in the legend.
        color: colour of the line.
        width: line width in pixels.
        dash: plotly's name of the pattern.
    """
    style = {"color": color, "width": width, "dash": dash}
    return scatter("lines", [at, at], list(span), name, line=style, hoverinfo="skip")


def dots(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    name: str,
    unit: Unit,
    color: str,
    *,
    row: int = 1,
    symbol: str = "circle",
    size: int = 8,
    remarks: Sequence[str] = (),
) -> Trace:
    """Draw a mark for every sample of y against x.

    Args:
        x: abscissa as shown, shape (n,).
        y: ordinate before conversion, shape (n,); values that are not finite are not drawn.
        name: entry in the legend.
        unit: unit to show y in.
        color: colour of the marks.
        row: row of the figure, 1 on top.
        symbol: plotly's name of the mark; "-open" makes it hollow.
        size: size in pixels.
        remarks: text beside the value under the cursor, one per sample.
    """
    marker = {"color": color, "size": size, "symbol": symbol, "line": {"width": 1.6, "color": color}}
    hover = f"%{{y:,.4~g}} {unit.symbol}{' · %{text}' if len(remarks) else ''}"
    style = {"marker": marker, "text": list(remarks), "hovertemplate": hover}
    return scatter("markers", packed(x), packed(y * unit.factor), name, row=row, **style)


def time_layout(duration: float, rows: Sequence[Axis]) -> Layout:
    """Return the layout of rows over one time axis.

    Args:
        duration: length of the run [s].
        rows: vertical axes from top to bottom.

    Returns:
        A plotly layout.
    """
    layout = stacked_layout(Axis("time since start", SECOND, (0.0, duration or 1.0)), rows) | {
        "hovermode": "x unified",
        "hoverdistance": -1,
        "hoversubplots": "axis",
        "yaxis9": {"overlaying": "y", "range": [0, 1], "visible": False, "fixedrange": True},
    }
    layout["xaxis"]["unifiedhovertitle"] = {"text": "%{x:,.7~g} s"}
    return layout


def stacked_layout(x: Axis, rows: Sequence[Axis]) -> Layout:
    """Return the layout of rows over one horizontal axis.

    Args:
        x: horizontal axis.
        rows: vertical axes from top to bottom.

    Returns:
        A plotly layout.
    """
    last = "y" if len(rows) == 1 else f"y{len(rows)}"
    layout = _layout() | {"hovermode": "closest", "xaxis": _axis(x) | {"anchor": last}}
    space = 0.06
    unit_height = (1 - space * (len(rows) - 1)) / sum(row.share for row in rows)
    top = 1.0
    for number, row in enumerate(rows, start=1):
        bottom = max(top - row.share * unit_height, 0.0)
        layout["yaxis" if number == 1 else f"yaxis{number}"] = _axis(row) | {"domain": [bottom, top], "anchor": "x"}
        top = bottom - space
    return layout


def decades(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
    """Return the limits of a logarithmic axis, with a margin around the finite positive values.

    Args:
        values: as shown, shape (n,).
    """
    drawn = np.asarray(values, dtype=float)
    drawn = drawn[np.isfinite(drawn) & (drawn > 0)]
    return (0.7 * float(drawn.min()), 1.5 * float(drawn.max())) if drawn.size else (1.0, 10.0)


def _layout() -> Layout:
    return {
        "font": {"family": FONT, "size": 12, "color": BLACK},
        "margin": {"l": 78, "r": 18, "t": 26, "b": 44},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "legend": {
            "orientation": "h",
            "x": 0,
            "xanchor": "left",
            "y": 1.0,
            "yanchor": "bottom",
            "traceorder": "normal",
        },
        "showlegend": True,
        "separators": ".\u202f",
    }


def _axis(axis: Axis) -> Layout:
    layout: Layout = {
        "title": {"text": axis.quantity if axis.names else f"{axis.quantity} [{axis.unit.symbol}]", "standoff": 8},
        "gridcolor": "#ebebeb",
        "zerolinecolor": "#b0b0b0",
        "zerolinewidth": 1,
        "linecolor": GREY,
        "showline": True,
        "ticks": "outside",
        "ticklen": 4,
        "exponentformat": "none",
        "separatethousands": True,
    }
    if axis.span is not None and axis.logarithmic:
        low, high = (float(np.log10(end)) for end in axis.span)
        layout |= {"type": "log", "range": [low, high]}
        if high - low > 0.7:
            # More labels would be turned, and lie across the axis' title.
            steps = (1, 2, 5) if high - low < 2 else (1,)
            decades = range(int(np.floor(low)), int(np.ceil(high)))
            layout["tickvals"] = [step * 10.0**decade for decade in decades for step in steps] + [10.0 ** np.ceil(high)]
    elif axis.span is not None:
        layout["range"] = list(axis.span)
    if axis.names:
        layout |= {"tickvals": list(range(1, len(axis.names) + 1)), "ticktext": list(axis.names), "automargin": True}
    return layout
