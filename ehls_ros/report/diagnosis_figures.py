"""Further figures of the diagnosis report: stages, shares, residual of a channel over each signal, free run."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.free_run import FreeRun
from ehls_ros.diagnosis.result import ChannelTrace, Diagnosis
from ehls_ros.diagnosis.stages import VOLUMES, Channel
from ehls_ros.report import plot
from ehls_ros.report.diagnosis_findings import (
    CHANNEL_WORDS,
    STAGE_NAMES,
    after_name,
    before_name,
    capital,
    compares,
    noun_of,
)
from ehls_ros.report.diagnosis_residuals import FLOOR, MIN_IN_BIN, SMALL_BINS, SPREAD, curve, members, signals_of, span, whole
from ehls_ros.report.page import LeftOut, Panel, Rows, number, plane
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
    bars,
    stacked_layout,
)
from ehls_ros.report.quantities import percent, shown_signal, unit_for

ROW_HEIGHT, COLUMN_WIDTH, MAX_COLUMNS = 190, 190, 4
"""Height and least width of the small plots in pixels, and maximum number of them side by side."""

STAGE_HEIGHT = 76
"""Height of a stage's bars in pixels."""

BAR_ROW_HEIGHT, BAR_WIDTH = 52, 0.5
"""Height of a bar of shares with its label in pixels, and fraction of it for the bar."""

PARTS = (("closed by the causes", BLUE), ("returns without that cause", SKY), ("remains", VERMILION))
"""Names and colours of the parts of a bar of shares."""

FREE_RUN_INTERVALS = 600
"""Number of intervals to which a line of a free run is reduced."""

SMALL_PLOT_SIGNALS: tuple[tuple[str, ...], ...] = (
    ("time_s",),
    ("velocity_m_s",),
    ("position_m",),
    ("load_pressure_pa", "force_n"),
    ("spool_m", "valve_command_m"),
    ("oil_temperature_k",),
)
"""Signals of the small plots; the first recorded one of each group is drawn."""

LAST_SIGNAL: Mapping[str, str] = dict.fromkeys((*VOLUMES, "supply"), "load_pressure_rate_pa_s")
"""Last signal of a channel's small plots; the acceleration for all others."""


# --- the stages ----------------------------------------------------------------------------------


def stage_bars(found: Diagnosis) -> Panel | LeftOut:
    """Draw the residual of each stage with both models, beside the noise."""
    title = "Residual of each stage"
    evaluated = [(stage, result) for stage, result in found.stages.items() if result.judged]
    if not evaluated:
        return LeftOut(title, "no stage could be evaluated")
    names = [STAGE_NAMES[stage] for stage, _ in evaluated]
    columns: list[tuple[str, str, list[float | None]]] = [
        (before_name(found), VERMILION, [result.nrmse_before for _, result in evaluated]),
        *([(after_name(found), BLUE, [r.nrmse_after for _, r in evaluated])] if compares(found) else []),
        ("noise", GREEN, [result.noise_floor for _, result in evaluated]),
    ]
    largest = max((value for *_, values in columns for value in values if value is not None), default=0.0)
    traces = [
        bars(
            [None if value is None else 100.0 * value for value in values],
            list(range(1, len(names) + 1)),
            name,
            color,
            "%{x:,.3~g} %<extra></extra>",
            orientation="h",
            text=["" if value is None else f"{number(100.0 * value, 2)} %" for value in values],
            textposition="outside",
            cliponaxis=False,
        )
        for name, color, values in columns
    ]
    x = Axis("rms residual", Unit("% of largest term"), (0.0, 120.0 * largest or 1.0))
    y = Axis("", PURE_NUMBER, (len(names) + 0.6, 0.4), names=tuple(names))
    height, text = 110 + STAGE_HEIGHT * len(names), {"minsize": 10, "mode": "show"}
    return plane(title, traces, x, y, height=height, barmode="group", bargap=0.3, uniformtext=text)


def share_bars(found: Diagnosis) -> Panel | None:
    """Draw each channel's removable error closed by the causes, its remainder, and the share of each cause."""
    labelled: list[tuple[str, tuple[float | None, float | None, float | None]]] = []
    for channel, gain in ({} if found.gain is None else found.gain.channels).items():
        closed = max(gain.closed, 0.0)
        label = f"{CHANNEL_WORDS[channel].short}: {percent(closed)} closed, {percent(1.0 - closed)} remains"
        labelled.append((label, (closed, None, 1.0 - closed)))
        own = [(noun_of(cause), max(cause.share or 0.0, 0.0)) for cause in found.causes if cause.channel == channel]
        labelled += [(f"{percent(share)}: {noun}", (None, share, None)) for noun, share in own if len(own) > 1]
    if not labelled:
        return None
    texts, lengths = zip(*labelled, strict=True)
    rows = list(range(len(texts), 0, -1))
    style = {"orientation": "h", "width": BAR_WIDTH}
    traces = [
        bars([100.0 * (x or 0.0) for x in part], rows, name, color, f"{name}: %{{x:,.3~g}} %<extra></extra>", **style)
        for (name, color), part in zip(PARTS, zip(*lengths, strict=True), strict=True)
        if any(x is not None for x in part)
    ]
    longest = max(sum(filter(None, parts)) for parts in lengths)
    beside = {"x": 0.0, "xanchor": "left", "yanchor": "bottom", "showarrow": False, "font": {"size": 11}}
    note = (
        "100 % is the mean square of the given model's residual beyond the noise. A cause's share is the error that returns"
        " without it, with all others fitted again. Shares need not add up, as causes may replace or need each other."
    )
    panel = plane(
        "Shares of the error",
        traces,
        Axis("share of the removable error", Unit("%"), (0.0, 102.0 * max(longest, 1.0))),
        Axis("", PURE_NUMBER, (0.4, len(texts) + 0.8)),
        note,
        100 + BAR_ROW_HEIGHT * len(texts),
        barmode="stack",
        annotations=[
            beside | {"y": row + 0.5 * BAR_WIDTH, "text": escape(text)} for row, text in zip(rows, texts, strict=True)
        ],
    )
    panel.layout["yaxis"]["visible"] = False
    panel.layout["margin"] |= {"l": 14}
    return panel


# --- small plots ------------------------------------------------------------------------------


def residuals_of(found: Diagnosis, channel: Channel) -> Panel | LeftOut:
    """Draw a channel's residual against every signal, and its spectrum."""
    trace = found.traces[channel]
    title = capital(CHANNEL_WORDS[channel].residual)
    if len(trace.time) < MIN_IN_BIN:
        return LeftOut(title, f"only {len(trace.time)} windows are usable")
    if not (np.any(trace.before) or np.any(trace.after)):
        return LeftOut(title, "it closes exactly and has no noise")
    unit = unit_for(trace.unit, float(np.quantile(np.abs(trace.before), 0.98)))
    same = np.array_equal(trace.before, trace.after)
    residuals = [(trace.before, before_name(found), VERMILION)]
    residuals += [] if same else [(trace.after, after_name(found), BLUE)]
    signals = signals_of(trace)
    shown = [next((name for name in group if name in signals), None) for group in SMALL_PLOT_SIGNALS]
    last = LAST_SIGNAL.get(channel, "acceleration_m_s2")
    against = [name for name in (*shown, last) if name is not None and name in signals]
    rows = -(-(len(against) + 1) // MAX_COLUMNS)
    columns = -(-(len(against) + 1) // rows)
    y = Axis("residual", unit, _small_span(trace, [r for r, *_ in residuals], unit))
    traces: list[Trace] = []
    layout: Layout = {}
    for place, signal in enumerate(against):
        x = shown_signal(signal, signals[signal])
        traces += _small(x.values, trace, residuals, unit, _axes(place))
        _place(layout, place, (rows, columns), Axis(x.quantity, x.unit, whole(x.values)), y)
    lines, axes = _spectra(trace, residuals, unit, _axes(len(against)))
    traces += lines
    _place(layout, len(against), (rows, columns), *axes)
    layout["legend"] |= {"y": 1.0 + 0.03 * 3 / rows}
    note = "The extension changes nothing here." if same and found.names_causes else ""
    height, width = ROW_HEIGHT * rows + 60, COLUMN_WIDTH * columns
    return Panel(title, traces, layout, note, height=height, over_time=False, least_width=width)


def _small_span(trace: ChannelTrace, residuals: Sequence[Array], unit: Unit) -> tuple[float, float]:
    low, high = span([r * unit.factor for r in residuals], 0.02)
    noise = 1.3 * SPREAD * float(np.sqrt(np.mean(trace.floor**2))) * unit.factor
    return min(low, -noise), max(high, noise)


def _small(
    values: Array, trace: ChannelTrace, residuals: Sequence[tuple[Array, str, str]], unit: Unit, axes: Trace
) -> list[Trace]:
    """Draw means, bands and noise over the classes of a signal, with the legend in the first plot only."""
    out: list[Trace] = []
    legend = axes["xaxis"] == "x"
    groups = members(values, SMALL_BINS)
    middles = np.array([float(np.mean(values[group])) for group in groups])
    noise = np.array([SPREAD * float(np.sqrt(np.mean(trace.floor[group] ** 2))) for group in groups])
    for residual, name, color in residuals:
        low, high = (np.array([float(np.quantile(residual[group], part)) for group in groups]) for part in (0.1, 0.9))
        mean = np.array([float(np.mean(residual[group])) for group in groups])
        area = plot.region(middles, low, high, "", unit, color, 0.2 if color == VERMILION else 0.25)
        out += [
            area | {"showlegend": False, **axes},
            curve(middles, mean, name, unit, color, showlegend=legend, legendgroup=name, **axes),
        ]
    for sign in (1.0, -1.0):
        own = {"showlegend": legend and sign > 0.0, "legendgroup": FLOOR, "hoverinfo": "skip", **axes}
        out.append(curve(middles, sign * noise, FLOOR, unit, GREEN, width=1.0, dash="dash", **own))
    return out


def _spectra(
    trace: ChannelTrace, residuals: Sequence[tuple[Array, str, str]], unit: Unit, axes: Trace
) -> tuple[list[Trace], tuple[Axis, Axis]]:
    out: list[Trace] = []
    largest, smallest, frequency = 0.0, np.inf, np.ones(1)
    for residual, name, color in (*residuals, (trace.noise, FLOOR, GREEN)):
        frequency, density = spectrum(trace.time, residual)
        largest, smallest = max(largest, float(density.max())), min(smallest, float(np.quantile(density, 0.02)))
        dash = "dash" if color == GREEN else "solid"
        out.append(curve(frequency, density, name, unit, color, width=1.4, dash=dash, showlegend=False, **axes))
    low = max(0.7 * smallest, 1e-6 * largest, 1e-12 / unit.factor)
    span = low * unit.factor, max(1.5 * largest, 10.0 * low) * unit.factor
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
    frequency, density = scipy.signal.welch(even, 1.0 / period, nperseg=min(512, len(even)), detrend=False)
    share = len(time) / len(even)
    return frequency[1:], np.sqrt(density[1:] / share)


def _axes(place: int) -> Trace:
    """Return the axis keys of a trace in a small plot."""
    suffix = str(place + 1) if place else ""
    return {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}


def _place(layout: Layout, place: int, grid: tuple[int, int], x: Axis, y: Axis) -> None:
    """Add the axes of a small plot to the common layout; ``grid`` is rows and columns."""
    rows, columns = grid
    plane = stacked_layout(x, [y])
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
    figure = Rows(title, run.time, buckets=FREE_RUN_INTERVALS)
    for signal in chosen:
        x = shown_signal(signal.name, signal.measured)
        first = figure.row(Axis(x.quantity, x.unit, _free_span(signal.measured, x.unit))) == 1
        drawn = [(signal.measured, "measured", SKY, 4.0, "solid"), (signal.before, "given model", VERMILION, 1.5, "solid")]
        if signal.after is not None:
            drawn.append((signal.after, "extended model", BLACK, 1.2, "dash"))
        for values, name, color, width, dash in drawn:
            figure.line(values, name, color, width=width, dash=dash, legendgroup=name, showlegend=first)
    return figure.panel(height=120 + 150 * len(chosen), over_time=False)


def _free_span(measured: Array, unit: Unit) -> tuple[float, float]:
    low, high = float(np.min(measured)) * unit.factor, float(np.max(measured)) * unit.factor
    margin = 0.3 * (high - low) or 1.0
    return low - margin, high + margin
