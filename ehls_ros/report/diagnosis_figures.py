"""Further figures of the diagnosis report: all stages, a channel's residual over every signal, the free run."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.free_run import FreeRun
from ehls_ros.diagnosis.result import ChannelTrace, Diagnosis
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.report.diagnosis_findings import (
    CHANNEL_NAMES,
    STAGE_NAMES,
    after_name,
    before_name,
    capital,
    compares,
)
from ehls_ros.report.diagnosis_residuals import FLOOR, SMALL_BINS, SPREAD, curve, span, whole
from ehls_ros.report.diagnosis_units import Shown, shown_signal, unit_for
from ehls_ros.report.diagnosis_views import LEAST_IN_BIN, members, signals_of
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
    packed,
    plane_layout,
    time_layout,
    time_line,
)

ROW_HEIGHT, COLUMN_WIDTH, MOST_COLUMNS = 190, 190, 4
"""Height and least width of the small plots in pixels, and maximum number of them side by side."""

ROW_OF_STAGE = 76
"""Height of a stage's bars in pixels."""

LINES = 600
"""Number of intervals to which a line of a free run is reduced."""

SMALL: tuple[tuple[str, ...], ...] = (
    ("time_s",),
    ("velocity_m_s",),
    ("position_m",),
    ("load_pressure_pa", "force_n"),
    ("spool_m", "valve_command_m"),
    ("oil_temperature_k",),
)
"""Signals of the small plots; of each group the first that was recorded."""

LAST: Mapping[str, str] = {"volume": "load_pressure_rate_pa_s", "supply": "load_pressure_rate_pa_s"}
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


# --- small plots ------------------------------------------------------------------------------


def residuals_of(found: Diagnosis, channel: Channel) -> Panel | LeftOut:
    """Draw a channel's residual against every signal, and its spectrum."""
    trace = found.traces[channel]
    title = capital(CHANNEL_NAMES[channel])
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
        _place(layout, place, (rows, columns), Axis(x.quantity, x.unit, whole(x.values)), y)
    lines, axes = _spectra(trace, residuals, unit, len(against) + 1)
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
    x: Shown, trace: ChannelTrace, residuals: Sequence[tuple[Array, str, str]], unit: Unit, number_of: int
) -> list[Trace]:
    axes = {"xaxis": f"x{number_of}" if number_of > 1 else "x", "yaxis": f"y{number_of}" if number_of > 1 else "y"}
    out: list[Trace] = []
    groups = members(x.values, SMALL_BINS)
    middles = np.array([float(np.mean(x.values[group])) for group in groups])
    noise = np.array([SPREAD * float(np.sqrt(np.mean(trace.floor[group] ** 2))) for group in groups]) * unit.factor
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
    frequency, density = scipy.signal.welch(even, 1.0 / period, nperseg=min(512, len(even)), detrend=False)
    share = len(time) / len(even)
    return frequency[1:], np.sqrt(density[1:] / share)


def _place(layout: Layout, place: int, grid: tuple[int, int], x: Axis, y: Axis) -> None:
    """Add the axes of a small plot to the common layout; ``grid`` is rows and columns."""
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
