"""The figures of the diagnosis report."""

from collections.abc import Callable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.signal import welch

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.free_run import FreeRun
from ehls_ros.diagnosis.result import ChannelGain, ChannelTrace, Diagnosis
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.report.diagnosis_findings import (
    CHANNEL_NAMES,
    CHANNEL_SHORT,
    STAGE_NAMES,
    after_name,
    before_name,
    capital,
    compares,
    words,
)
from ehls_ros.report.diagnosis_units import Shown, percent, quantity, shown_signal, unit_for
from ehls_ros.report.diagnosis_views import BINS, LEAST_IN_BIN, View, classes, members, signals_of
from ehls_ros.report.page import LeftOut, Panel, number
from ehls_ros.report.plot import (
    BLACK,
    BLUE,
    GREEN,
    PURE_NUMBER,
    SKY,
    VERMILION,
    Axis,
    Layout,
    Trace,
    Unit,
    band,
    packed,
    plane_layout,
    time_layout,
    time_line,
)

POINTS = 2000
"""Largest number of dots of one residual in the main picture."""

SMALL_BINS = 24
"""Classes in the small pictures."""

ROW_HEIGHT, COLUMN_WIDTH, MOST_COLUMNS = 190, 190, 4
"""Height and least width of the small pictures in pixels, and most of them side by side."""

ROW_OF_BAR, BAR_WIDTH = 52, 0.5
"""Height of a bar of shares with its label in pixels, and the fraction of it that the bar takes."""

ROW_OF_STAGE = 76
"""Height of a stage's bars in pixels."""

MOST_SHOWN = 2.0
"""Longest bar that is drawn in full, as a multiple of the removable error; noise may exceed it."""

GAP = 3.0
"""Time between two windows over which no line is drawn, as a multiple of the usual one."""

LINES = 600
"""Number of intervals a line of a free run is reduced to."""

FLOOR = "noise, 95 %"

BESIDE = ((BLACK, "dash"), (GREEN, "dot"))
"""Colour and pattern of further means in a picture."""

_SPREAD = 2.0

SMALL: tuple[tuple[str, ...], ...] = (
    ("time_s",),
    ("velocity_m_s",),
    ("position_m",),
    ("load_pressure_pa", "force_n"),
    ("spool_m", "valve_command_m"),
    ("oil_temperature_k",),
)
"""Signals of the small pictures; of each group the first that was recorded."""

LAST: Mapping[str, str] = {"volume": "load_pressure_rate_pa_s", "supply": "load_pressure_rate_pa_s"}
"""Last signal of a channel's small pictures; the acceleration for all others."""


# --- the main picture --------------------------------------------------------------------------


class Cloud(NamedTuple):
    """The residuals of one model along one recording, for a picture over a signal.

    Attributes:
        title: heading of the picture.
        color: of the dots and their mean.
        signal: the signal over the windows, in SI, shape (n,).
        residual: the residual, in the unit of its channel, shape (n,).
        floor: noise floor, shape (n,).
        beside: other means to compare with, by name: signal and residual, shape (m,) each.
    """

    title: str
    color: str
    signal: Array
    residual: Array
    floor: Array
    beside: Mapping[str, tuple[Array, Array]] = MappingProxyType({})


def over_time(found: Diagnosis, channel: Channel) -> Panel:
    """Draw a channel's residual over time, without and with the causes, and the band of noise."""
    trace = found.traces[channel]
    unit = unit_for(trace.unit, float(np.quantile(np.abs(trace.before), 0.98)))
    traces = band(trace.time, _SPREAD * trace.floor, FLOOR, unit)
    gaps = np.flatnonzero(np.diff(trace.time) > GAP * np.median(np.diff(trace.time))) + 1
    time = np.insert(trace.time, gaps, trace.time[gaps - 1])
    for name, color, residual in ((before_name(found), VERMILION, trace.before), (after_name(found), BLUE, trace.after)):
        broken = np.insert(residual, gaps, np.nan)
        traces.append(time_line(time, broken, f"{name}, {_rms(residual, unit)}", unit, color, width=1.2))
    layout = time_layout(float(trace.time[-1]), [Axis(f"{CHANNEL_SHORT[channel]}, residual", unit)])
    title = f"{capital(CHANNEL_SHORT[channel])}, without and with the {'cause' if len(found.causes) == 1 else 'causes'}"
    note = "" if found.baseline is None else "Less what the baselines lead to expect, and what varies without a fault."
    return Panel(title, traces, layout, note, height=360)


def _rms(residual: Array, unit: Unit) -> str:
    return f"rms {number(float(np.sqrt(np.mean(residual**2))) * unit.factor, 2)} {unit.symbol}"


def before_and_after(found: Diagnosis, view: View) -> list[Panel]:
    """Draw a channel's residual over a signal, without and with the causes."""
    trace = found.traces[view.channel]
    models = ((capital(before_name(found)), VERMILION, trace.before), (capital(after_name(found)), BLUE, trace.after))
    clouds = [_cloud_of(trace, view, *model) for model in models]
    return planes(view.channel, view.signal, trace.unit, clouds, along=view.along)


def remaining(found: Diagnosis, views: Sequence[View]) -> list[Panel]:
    """Draw what remains of a channel's residual over each signal."""
    drawn = []
    for view in views:
        trace = found.traces[view.channel]
        cloud = _cloud_of(trace, view, f"Unexplained, over the {quantity(view.signal)}", BLUE, trace.after)
        drawn += planes(view.channel, view.signal, trace.unit, [cloud], along=view.along)
    return drawn


def _cloud_of(trace: ChannelTrace, view: View, title: str, color: str, residual: Array) -> Cloud:
    sign = np.sign(trace.against["velocity_m_s"]) if view.along else 1.0
    return Cloud(title, color, signals_of(trace)[view.signal], residual * sign, trace.floor)


def planes(channel: Channel, signal: str, unit: str, clouds: Sequence[Cloud], *, along: bool = False) -> list[Panel]:
    """Draw residuals over a signal, a picture each, all with the same axes.

    Args:
        channel: channel of the residuals.
        signal: name of the signal.
        unit: unit of the residuals.
        clouds: what to draw.
        along: the residuals are counted along the motion.
    """
    y_unit = unit_for(unit, max(float(np.quantile(np.abs(cloud.residual), 0.98)) for cloud in clouds))
    largest = max(float(np.max(np.abs(cloud.signal))) for cloud in clouds)

    def scaled(values: Array) -> Shown:
        return shown_signal(signal, values, largest)

    x = scaled(np.concatenate([cloud.signal for cloud in clouds]))
    name = f"{CHANNEL_SHORT[channel]}, residual{' × sign of velocity' if along else ''}"
    axes = (
        Axis(x.quantity, x.unit, _whole(x.values)),
        Axis(name, y_unit, span([cloud.residual * y_unit.factor for cloud in clouds])),
    )
    return [_plane(cloud, scaled, axes) for cloud in clouds]


def _plane(cloud: Cloud, scaled: Callable[[Array], Shown], axes: tuple[Axis, Axis]) -> Panel:
    x, unit = scaled(cloud.signal), axes[1].unit
    kept = _thinned(len(x.values))
    traces = _band(x, cloud.floor, unit)
    traces.append(_dots(x.values[kept], cloud.residual[kept] * unit.factor, unit, cloud.color))
    lines = {"mean": (cloud.signal, cloud.residual), **cloud.beside}
    styles = ((_dark(cloud.color), "solid"), *BESIDE)
    for (name, (signal, residual)), (color, dash) in zip(lines.items(), styles, strict=False):
        means, middles, _ = classes(scaled(signal).values, residual * unit.factor, BINS)
        traces.append(curve(middles, means, name, unit, color) | {"line": {"color": color, "width": 2.2, "dash": dash}})
    layout = plane_layout(*axes)
    layout["legend"] |= {"itemsizing": "constant"}
    return Panel(f"{cloud.title}: {_rms(cloud.residual, unit)}", traces, layout, height=400, over_time=False)


def _thinned(count: int) -> slice:
    return slice(None, None, max(1, -(-count // POINTS)))


def _whole(values: Array) -> tuple[float, float]:
    low, high = float(np.min(values)), float(np.max(values))
    air = 0.02 * (high - low) or 1.0
    return low - air, high + air


def span(residuals: Sequence[Array], part: float = 0.002) -> tuple[float, float]:
    """Return the ends of an axis for residuals, without the fraction ``part`` at either end that lies farthest out."""
    low = min(float(np.quantile(r, part)) for r in residuals)
    high = max(float(np.quantile(r, 1.0 - part)) for r in residuals)
    air = 0.12 * (high - low) or 1.0
    return low - air, high + air


def _band(x: Shown, floor: Array, unit: Unit) -> list[Trace]:
    squares, middles, _ = classes(x.values, floor**2, SMALL_BINS)
    half = _SPREAD * np.sqrt(squares) * unit.factor
    at = np.concatenate([middles, middles[::-1]])
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "x": packed(at),
            "y": packed(np.concatenate([half, -half[::-1]])),
            "fill": "toself",
            "fillcolor": "rgba(0, 158, 115, 0.22)",
            "line": {"color": GREEN, "width": 0.8},
            "name": FLOOR,
            "hoverinfo": "skip",
        }
    ]


def _dots(x: Array, y: Array, unit: Unit, color: str) -> Trace:
    return {
        "type": "scatter",
        "mode": "markers",
        "x": packed(x),
        "y": packed(y),
        "name": "windows",
        "marker": {"color": color, "size": 3.5, "opacity": 0.35},
        "hovertemplate": f"%{{y:,.4~g}} {unit.symbol}<extra></extra>",
    }


def curve(x: Array, y: Array, name: str, unit: Unit, color: str) -> Trace:
    """Return a line over a signal."""
    return {
        "type": "scatter",
        "mode": "lines",
        "x": packed(x),
        "y": packed(y),
        "name": name,
        "line": {"color": color, "width": 2.4},
        "hovertemplate": f"%{{y:,.4~g}} {unit.symbol}<extra></extra>",
    }


def _dark(color: str) -> str:
    return {VERMILION: "#8a3c00", BLUE: "#003e63"}.get(color, color)


# --- the shares ----------------------------------------------------------------------------------


class _Bar(NamedTuple):
    """A bar of shares of the removable error: its label, and the length of each part, by the part's name."""

    label: str
    parts: Mapping[str, float]


CLOSED, RETURNS, REMAINS, NOISE = "closed by the causes", "returns without that cause", "remains", "noise"
_PARTS = ((CLOSED, BLUE), (RETURNS, SKY), (REMAINS, VERMILION), (NOISE, GREEN))


def share_bars(found: Diagnosis) -> Panel | None:
    """Draw what the causes close of each channel's removable error, what remains, the noise, and the share of each cause."""
    gains = {} if found.gain is None else found.gain.channels
    bars = [bar for channel, closed in gains.items() for bar in _bars(found, channel, closed)]
    if not bars:
        return None
    rows = list(range(len(bars), 0, -1))
    traces: list[Trace] = [
        {
            "type": "bar",
            "orientation": "h",
            "x": [100.0 * bar.parts.get(part, 0.0) for bar in bars],
            "y": rows,
            "width": BAR_WIDTH,
            "name": part,
            "marker": {"color": color},
            "hovertemplate": f"{part}: %{{x:,.3~g}} %<extra></extra>",
        }
        for part, color in _PARTS
        if any(part in bar.parts for bar in bars)
    ]
    longest = min(max(sum(bar.parts.values()) for bar in bars), MOST_SHOWN)
    layout = plane_layout(
        Axis("share of the removable error", Unit("%"), (0.0, 102.0 * max(longest, 1.0))),
        Axis("", PURE_NUMBER, (0.4, len(bars) + 0.8)),
    )
    layout["yaxis"]["visible"] = False
    label = {"x": 0.0, "xanchor": "left", "yanchor": "bottom", "showarrow": False, "font": {"size": 11}}
    layout |= {
        "barmode": "stack",
        "margin": layout["margin"] | {"l": 14},
        "annotations": [
            label | {"y": row + 0.5 * BAR_WIDTH, "text": escape(bar.label)} for row, bar in zip(rows, bars, strict=True)
        ],
    }
    note = (
        "100 % is the mean square of the given model's residual beyond the noise. A cause's share is what returns without it,"
        " all others fitted again; shares need not add up, as causes may replace or need each other."
    )
    return Panel("Shares of the error", traces, layout, note, height=100 + ROW_OF_BAR * len(bars), over_time=False)


def _bars(found: Diagnosis, channel: Channel, gain: ChannelGain) -> list[_Bar]:
    closed = max(gain.closed, 0.0)
    own = [cause for cause in found.causes if cause.channel == channel]
    sizes = f"{percent(closed)} closed, {percent(1.0 - closed)} remains, noise {percent(gain.noise)}"
    first = _Bar(f"{CHANNEL_SHORT[channel]}: {sizes}", {CLOSED: closed, REMAINS: 1.0 - closed, NOISE: gain.noise})
    if len(own) < 2:
        return [first]
    shares = [(words(cause.name).noun, max(cause.share or 0.0, 0.0)) for cause in own]
    return [first, *(_Bar(f"{percent(share)}: {noun}", {RETURNS: share}) for noun, share in shares)]


# --- the stages ----------------------------------------------------------------------------------


def stage_bars(found: Diagnosis) -> Panel | LeftOut:
    """Draw the residual of each stage with both models, beside the noise floor."""
    title = "Residual of each stage"
    evaluated = [(stage, result) for stage, result in found.stages.items() if result.judged]
    if not evaluated:
        return LeftOut(title, "no stage could be evaluated")
    names = [STAGE_NAMES[stage] for stage, _ in evaluated]
    columns: list[tuple[str, str, list[float | None]]] = [
        (before_name(found), VERMILION, [result.nrmse_before for _, result in evaluated]),
        *([(after_name(found), BLUE, [r.nrmse_after for _, r in evaluated])] if compares(found) else []),
        ("noise floor", GREEN, [result.noise_floor for _, result in evaluated]),
    ]
    largest = max((value for *_, values in columns for value in values if value is not None), default=0.0)
    traces: list[Trace] = [
        {
            "type": "bar",
            "orientation": "h",
            "x": [None if value is None else 100.0 * value for value in values],
            "y": list(range(1, len(names) + 1)),
            "name": name,
            "marker": {"color": color},
            "text": ["" if value is None else f"{number(100.0 * value, 2)} %" for value in values],
            "textposition": "outside",
            "cliponaxis": False,
            "hovertemplate": "%{x:,.3~g} %<extra></extra>",
        }
        for name, color, values in columns
    ]
    layout = plane_layout(
        Axis("rms residual", Unit("% of largest term"), (0.0, 120.0 * largest or 1.0)),
        Axis("", PURE_NUMBER, (len(names) + 0.6, 0.4), names=tuple(names)),
    )
    layout |= {"barmode": "group", "bargap": 0.3, "uniformtext": {"minsize": 10, "mode": "show"}}
    return Panel(title, traces, layout, height=110 + ROW_OF_STAGE * len(names), over_time=False)


# --- small pictures ---------------------------------------------------------------------------


def residuals_of(found: Diagnosis, channel: Channel) -> Panel | LeftOut:
    """Draw a channel's residual against every signal, and its spectrum."""
    trace = found.traces[channel]
    title = CHANNEL_NAMES[channel][0].upper() + CHANNEL_NAMES[channel][1:]
    if len(trace.time) < LEAST_IN_BIN:
        return LeftOut(title, f"only {len(trace.time)} windows are usable")
    if not (np.any(trace.before) or np.any(trace.after)):
        return LeftOut(title, "it closes exactly and has no noise")
    unit = unit_for(trace.unit, float(np.quantile(np.abs(trace.before), 0.98)))
    same = np.array_equal(trace.before, trace.after)
    residuals = [(trace.before, before_name(found), VERMILION)]
    residuals += [] if same else [(trace.after, after_name(found), BLUE)]
    signals = signals_of(trace)
    shown = [next((name for name in group if name in signals), None) for group in SMALL]
    last = LAST.get(channel, "acceleration_m_s2")
    against = [name for name in (*shown, last) if name is not None and name in signals]
    rows = -(-(len(against) + 1) // MOST_COLUMNS)
    columns = -(-(len(against) + 1) // rows)
    y = Axis("residual", unit, _small_span(trace, [r for r, *_ in residuals], unit))
    traces: list[Trace] = []
    layout: Layout = {}
    for place, signal in enumerate(against):
        x = shown_signal(signal, signals[signal])
        traces += _small(x, trace, residuals, unit, place + 1)
        _place(layout, place, (rows, columns), Axis(x.quantity, x.unit, _whole(x.values)), y)
    lines, axes = _spectra(trace, residuals, unit, len(against) + 1)
    traces += lines
    _place(layout, len(against), (rows, columns), *axes)
    layout["legend"] |= {"y": 1.0 + 0.03 * 3 / rows}
    note = "The extension changes nothing here." if same and found.names_causes else ""
    height, width = ROW_HEIGHT * rows + 60, COLUMN_WIDTH * columns
    return Panel(title, traces, layout, note, height=height, over_time=False, least_width=width)


def _small_span(trace: ChannelTrace, residuals: Sequence[Array], unit: Unit) -> tuple[float, float]:
    low, high = span([r * unit.factor for r in residuals], 0.02)
    noise = 1.3 * _SPREAD * float(np.sqrt(np.mean(trace.floor**2))) * unit.factor
    return min(low, -noise), max(high, noise)


def _small(
    x: Shown, trace: ChannelTrace, residuals: Sequence[tuple[Array, str, str]], unit: Unit, number_of: int
) -> list[Trace]:
    axes = {"xaxis": f"x{number_of}" if number_of > 1 else "x", "yaxis": f"y{number_of}" if number_of > 1 else "y"}
    out: list[Trace] = []
    groups = members(x.values, SMALL_BINS)
    middles = np.array([float(np.mean(x.values[group])) for group in groups])
    noise = np.array([_SPREAD * float(np.sqrt(np.mean(trace.floor[group] ** 2))) for group in groups]) * unit.factor
    for residual, name, color in residuals:
        low, mean, high = (
            np.array([float(f(residual[group])) for group in groups]) * unit.factor
            for f in (lambda v: np.quantile(v, 0.1), np.mean, lambda v: np.quantile(v, 0.9))
        )
        band = {
            "type": "scatter",
            "mode": "lines",
            "x": packed(np.concatenate([middles, middles[::-1]])),
            "y": packed(np.concatenate([low, high[::-1]])),
            "fill": "toself",
            "fillcolor": "rgba(213, 94, 0, 0.20)" if color == VERMILION else "rgba(0, 114, 178, 0.25)",
            "line": {"width": 0},
            "showlegend": False,
            "hoverinfo": "skip",
            **axes,
        }
        out += [band, curve(middles, mean, name, unit, color) | axes | {"showlegend": number_of == 1, "legendgroup": name}]
        out[-1]["line"] = {"color": color, "width": 1.8}
    for sign in (1.0, -1.0):
        out.append(
            curve(middles, sign * noise, FLOOR, unit, GREEN)
            | axes
            | {"line": {"color": GREEN, "width": 1.0, "dash": "dash"}, "showlegend": number_of == 1 and sign > 0.0}
            | {"legendgroup": FLOOR, "hoverinfo": "skip"}
        )
    return out


def _spectra(
    trace: ChannelTrace, residuals: Sequence[tuple[Array, str, str]], unit: Unit, number_of: int
) -> tuple[list[Trace], tuple[Axis, Axis]]:
    out: list[Trace] = []
    largest, smallest, frequency = 0.0, np.inf, np.ones(1)
    for residual, name, color in (*residuals, (trace.noise, FLOOR, GREEN)):
        frequency, density = spectrum(trace.time, residual * unit.factor)
        largest, smallest = max(largest, float(density.max())), min(smallest, float(np.quantile(density, 0.02)))
        line = curve(frequency, density, name, unit, color)
        width = {"color": color, "width": 1.4, "dash": "dash" if color == GREEN else "solid"}
        out.append(line | {"line": width, "xaxis": f"x{number_of}", "yaxis": f"y{number_of}", "showlegend": False})
    low = max(0.7 * smallest, 1e-6 * largest, 1e-12)
    span = low, max(1.5 * largest, 10.0 * low)
    return out, (
        Axis("frequency", Unit("Hz"), (float(frequency[0]), float(frequency[-1])), logarithmic=True),
        Axis("density", Unit(f"{unit.symbol}/√Hz"), span, logarithmic=True),
    )


def spectrum(time: Array, residual: Array) -> tuple[Array, Array]:
    """Return frequencies [Hz] and amplitude density of a residual; missing windows count as zero."""
    period = float(np.median(np.diff(time)))
    index = np.round((time - time[0]) / period).astype(np.int64)
    index = np.minimum(index, 4 * len(time))
    even = np.zeros(int(index[-1]) + 1)
    even[index] = residual
    frequency, density = welch(even, 1.0 / period, nperseg=min(512, len(even)), detrend=False)
    share = len(time) / len(even)
    return frequency[1:], np.sqrt(density[1:] / share)


def _place(layout: Layout, place: int, grid: tuple[int, int], x: Axis, y: Axis) -> None:
    """Add the axes of a small picture to the common layout; ``grid`` is rows and columns."""
    rows, columns = grid
    plane = plane_layout(x, y)
    suffix = "" if place == 0 else str(place + 1)
    if place == 0:
        layout |= plane
    row, column = divmod(place, columns)
    gap, high = 0.06, 0.30 / rows
    width = (1.0 - gap * (columns - 1)) / columns
    left, top = column * (width + gap), 1.0 - row / rows
    bottom = top - 1.0 / rows + (high if row < rows - 1 else 0.0)
    own = {"tickfont": {"size": 10}, "nticks": 6}
    layout[f"xaxis{suffix}"] = plane["xaxis"] | own | {"domain": [left, left + width], "anchor": f"y{suffix}"}
    layout[f"yaxis{suffix}"] = plane["yaxis"] | own | {"domain": [bottom, top], "anchor": f"x{suffix}"}
    for axis in ("xaxis", "yaxis"):
        layout[f"{axis}{suffix}"]["title"] |= {"font": {"size": 11}, "standoff": 3}
        layout[f"{axis}{suffix}"]["exponentformat"] = "power"


# --- free run ----------------------------------------------------------------------------------

_FREE = ("position_m", "load_pressure_pa", "force_n", "spool_m")


def free_run_panel(run: FreeRun) -> Panel | LeftOut:
    """Draw the free run of both models beside the measured signals."""
    title = "Free run"
    chosen = [signal for name in _FREE for signal in run.signals if signal.name == name]
    if any(signal.name == "load_pressure_pa" for signal in chosen):
        chosen = [signal for signal in chosen if signal.name != "force_n"]
    if not chosen:
        return LeftOut(title, "no signal moves by more than its noise")
    traces: list[Trace] = []
    rows: list[Axis] = []
    for signal in chosen:
        x = shown_signal(signal.name, signal.measured)
        rows.append(Axis(x.quantity, x.unit, _free_span(signal.measured, x.unit)))
        drawn = [(signal.measured, "measured", SKY, 4.0, "solid"), (signal.before, "given model", VERMILION, 1.5, "solid")]
        if signal.after is not None:
            drawn.append((signal.after, "extended model", BLACK, 1.2, "dash"))
        for values, name, color, width, dash in drawn:
            style = {"legendgroup": name, "showlegend": len(rows) == 1}
            traces.append(
                time_line(run.time, values, name, x.unit, color, row=len(rows), width=width, dash=dash, buckets=LINES) | style
            )
    layout = time_layout(float(run.time[-1]), rows)
    return Panel(title, traces, layout, height=120 + 150 * len(rows), over_time=False)


def _free_span(measured: Array, unit: Unit) -> tuple[float, float]:
    low, high = float(np.min(measured)) * unit.factor, float(np.max(measured)) * unit.factor
    air = 0.3 * (high - low) or 1.0
    return low - air, high + air
