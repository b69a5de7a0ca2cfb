"""Figures of a diagnosis' residuals over time and over the signal that shows an error best, without and with the causes."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.result import Cause, ChannelTrace, Diagnosis
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Group
from ehls_ros.report.diagnosis_findings import CHANNEL_WORDS, after_name, before_name, capital, compares
from ehls_ros.report.page import Panel, Rows, number, plane
from ehls_ros.report.plot import BLACK, BLUE, GREEN, SKY, VERMILION, Axis, Trace, Unit, band, packed, region, scatter
from ehls_ros.report.quantities import Shown, quantity, shown_signal, unit_for

BINS, MIN_IN_BIN = 40, 12
"""Largest number of classes of a signal for which means are drawn, and smallest number of windows in a class."""

MAX_SIGNALS = 4
"""Largest number of signals against which a remainder is drawn."""

TIMES = 8
"""Number of classes of time in which a residual is checked for drift."""

NEAR = 0.05
"""Shortfall in explained power, relative to the best signal, up to which a typical signal of an effect is preferred."""

PREFERRED_SIGNALS: Mapping[Group, tuple[str, ...]] = {
    "valve": ("spool_m", "valve_command_m"),
    "flow": ("load_pressure_pa", "load_pressure_rate_pa_s", "spool_m"),
    "friction": ("velocity_m_s",),
    "mechanics": ("position_m", "acceleration_m_s2"),
    "sensors": ("load_pressure_pa", "position_m", "velocity_m_s"),
    "environment": ("time_s",),
}
"""Signals through which effects of a group act, the preferred one first."""

POINTS = 2000
"""Maximum number of dots of one residual in the main figure."""

SMALL_BINS = 24
"""Number of classes of the noise band, and of the small plots."""

GAP = 3.0
"""Interval between two windows, as a multiple of the usual one, above which the line is interrupted."""

FLOOR, SPREAD = "noise, 95 %", 2.0
"""Name of the noise band, and its half width in standard deviations."""

DARK = {VERMILION: "#8a3c00", BLUE: "#003e63"}
"""Colour of the mean of dots of a colour, if it is not the same."""

BESIDE = ((BLACK, "dash"), (GREEN, "dot"))
"""Colour and pattern of further means in a figure."""


class Cloud(NamedTuple):
    """Residuals of one model along one recording, for a scatter plot over a signal.

    Attributes:
        title: heading of the figure.
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


class View(NamedTuple):
    """A channel's residual against the signal that explains it.

    Attributes:
        channel: channel of the residual.
        signal: signal on the horizontal axis.
        along: whether the residual is taken along the motion, multiplied by the sign of the velocity.
        explained: fraction of the residual's power in its class means over the signal.
    """

    channel: Channel
    signal: str
    along: bool
    explained: float


def view_of_cause(found: Diagnosis, cause: Cause) -> View | None:
    """Return the view that shows a cause best; None without traces."""
    if cause.channel not in found.traces:
        return None
    return _best_view(found, cause.channel, PREFERRED_SIGNALS[EFFECTS.load(cause.name).GROUP], after=False)


def views_of_rest(found: Diagnosis) -> list[View]:
    """Return the views of the unexplained remainder over the signals it depends on, otherwise over the best signal."""
    channels = [c for c in found.traces if CHANNELS[c] == found.unknown_stage]
    if not channels:
        return []
    channel = max(channels, key=lambda c: _power(found.traces[c].after / np.maximum(found.traces[c].floor, 1e-300)))
    signals = [signal for signal in found.depends_on if signal in signals_of(found.traces[channel])][:MAX_SIGNALS]
    return [_best_view(found, channel, (), after=True, first=(signal,)) for signal in signals] or [
        _best_view(found, channel, (), after=True)
    ]


def _power(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.mean(known**2)) if known.size else 0.0


def _best_view(found: Diagnosis, channel: Channel, preferred: Sequence[str], *, after: bool, first: Sequence[str] = ()) -> View:
    trace = found.traces[channel]
    residual = trace.after if after else trace.before
    views = [
        # Any slow change seems to depend on the time if there are enough classes.
        View(channel, signal, False, explained(values, residual, TIMES if signal == "time_s" else BINS))
        for signal, values in signals_of(trace).items()
    ]
    velocity = trace.against.get("velocity_m_s")
    if channel == "force" and velocity is not None:
        # A braking force changes sign with the motion, so it would average out over any other signal.
        turned = residual * np.sign(velocity)
        views += [
            View(channel, signal, True, explained(values, turned))
            for signal, values in signals_of(trace).items()
            if signal not in ("velocity_m_s", "acceleration_m_s2", "time_s")
        ]
    pointed = [view for view in views if view.signal in first]
    if pointed:
        return max(pointed, key=lambda view: view.explained)
    most = max(view.explained for view in views)
    order = {signal: place for place, signal in enumerate(preferred)}
    good = [view for view in views if view.explained >= most - NEAR]
    return min(good, key=lambda view: (order.get(view.signal, len(order)), view.along, -view.explained))


def signals_of(trace: ChannelTrace) -> dict[str, Array]:
    """Return the varying signals on which a residual may depend, by name."""
    found = {"time_s": trace.time, **trace.against}
    return {name: values for name, values in found.items() if float(np.ptp(values)) > 0.0} or {"time_s": trace.time}


def explained(values: Array, residual: Array, bins: int = BINS) -> float:
    """Return the fraction of a residual's power in its means over classes of a signal."""
    means, _, counts = classes(values, residual, bins)
    total = float(np.sum(residual**2))
    return float(np.sum(counts * means**2)) / total if total > 0.0 else 0.0


def _edges(values: Array, bins: int) -> Array:
    count = int(np.clip(len(values) // MIN_IN_BIN, 1, bins))
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)))


def _class_of(values: Array, edges: Array) -> Array:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))


def members(values: Array, bins: int) -> list[NDArray[np.intp]]:
    """Return the indices of the windows in each non-empty class of a signal."""
    edges = _edges(values, bins)
    index = _class_of(values, edges)
    found = [np.flatnonzero(index == i) for i in range(max(len(edges) - 1, 1))]
    return [group for group in found if group.size]


def classes(values: Array, residual: Array, bins: int) -> tuple[Array, Array, Array]:
    """Return the mean residual, the mean signal and the number of windows in each class of a signal, shape (classes,)."""
    edges = _edges(values, bins)
    index = _class_of(values, edges)
    counts = np.bincount(index, minlength=max(len(edges) - 1, 1)).astype(np.float64)
    kept = counts > 0
    means = np.bincount(index, residual, len(counts))[kept] / counts[kept]
    middles = np.bincount(index, values, len(counts))[kept] / counts[kept]
    return means, middles, counts[kept]


def over_time(found: Diagnosis, channel: Channel) -> Panel:
    """Draw a channel's measured and simulated quantity over time, and below it the residuals with the noise band."""
    trace = found.traces[channel]
    above, below = (unit_for(trace.unit, float(np.quantile(np.abs(v), 0.98))) for v in (trace.measured, trace.before))
    gaps = np.flatnonzero(np.diff(trace.time) > GAP * np.median(np.diff(trace.time))) + 1
    time = np.insert(trace.time, gaps, trace.time[gaps - 1])

    def broken(values: Array) -> Array:
        return np.insert(values, gaps, np.nan)

    models = [(before_name(found), VERMILION, "solid", trace.before)]
    if compares(found):
        models.append((after_name(found), BLUE, "dash", trace.after))
    title = f"{capital(CHANNEL_WORDS[channel].short)}, measured and simulated"
    figure = Rows(title, time, Axis(CHANNEL_WORDS[channel].measured, above))
    figure.line(broken(trace.measured), "measured", SKY, width=4.0)
    figure.traces += band(trace.time, SPREAD * trace.floor, f"{FLOOR}, {_rms(trace.floor, below)}", below, row=2)
    labels = {name: f"{name}, residual {_rms(residual, below)}" for name, _, _, residual in models}
    for name, color, dash, residual in models:
        simulated = broken(trace.simulated(residual))
        figure.line(simulated, labels[name], color, width=1.3, dash=dash, legendgroup=name)
    figure.row(Axis("residual", below))
    for name, color, _, residual in models:
        figure.line(broken(residual), labels[name], color, width=1.2, legendgroup=name, showlegend=False)
    note = "" if found.baseline is None else "Less the residual expected from the baselines and variation without a fault."
    return figure.panel(note, 460)


def _rms(residual: Array, unit: Unit) -> str:
    return f"rms {number(float(np.sqrt(np.mean(residual**2))) * unit.factor, 2)} {unit.symbol}"


def over_signal(found: Diagnosis, view: View) -> list[Panel]:
    """Draw a channel's residual over a signal, without and with the causes."""
    trace = found.traces[view.channel]
    models = ((capital(before_name(found)), VERMILION, trace.before), (capital(after_name(found)), BLUE, trace.after))
    clouds = [_cloud_of(trace, view, *model) for model in models]
    return planes(view.channel, view.signal, trace.unit, clouds, along=view.along)


def remaining(found: Diagnosis, views: Sequence[View]) -> list[Panel]:
    """Draw the remainder of a channel's residual over each signal."""
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
    """Draw residuals over a signal, one figure each, all with the same axes.

    Args:
        channel: channel of the residuals.
        signal: name of the signal.
        unit: unit of the residuals.
        clouds: the residuals to draw.
        along: whether the residuals are taken along the motion.
    """
    y_unit = unit_for(unit, max(float(np.quantile(np.abs(cloud.residual), 0.98)) for cloud in clouds))
    largest = max(float(np.max(np.abs(cloud.signal))) for cloud in clouds)

    def scaled(values: Array) -> Shown:
        return shown_signal(signal, values, largest)

    x = scaled(np.concatenate([cloud.signal for cloud in clouds]))
    name = f"{CHANNEL_WORDS[channel].short}, residual{' × sign of velocity' if along else ''}"
    axes = (
        Axis(x.quantity, x.unit, whole(x.values)),
        Axis(name, y_unit, span([cloud.residual * y_unit.factor for cloud in clouds])),
    )
    return [_plane(cloud, scaled, axes) for cloud in clouds]


def _plane(cloud: Cloud, scaled: Callable[[Array], Shown], axes: tuple[Axis, Axis]) -> Panel:
    x, unit = scaled(cloud.signal).values, axes[1].unit
    kept = slice(None, None, max(1, -(-len(x) // POINTS)))
    squares, middles, _ = classes(x, cloud.floor**2, SMALL_BINS)
    half = SPREAD * np.sqrt(squares)
    noise = region(middles, -half, half, FLOOR, unit, GREEN, 0.22) | {"line": {"color": GREEN, "width": 0.8}}
    marker = {"color": cloud.color, "size": 3.5, "opacity": 0.35}
    windows = curve(x[kept], cloud.residual[kept], "windows", unit, cloud.color, mode="markers", marker=marker)
    traces = [noise, windows]
    lines = {"mean": (cloud.signal, cloud.residual), **cloud.beside}
    styles = ((DARK.get(cloud.color, cloud.color), "solid"), *BESIDE)
    for (name, (signal, residual)), (color, dash) in zip(lines.items(), styles, strict=False):
        means, middles, _ = classes(scaled(signal).values, residual, BINS)
        traces.append(curve(middles, means, name, unit, color, width=2.2, dash=dash))
    panel = plane(f"{cloud.title}: {_rms(cloud.residual, unit)}", traces, *axes, height=400)
    panel.layout["legend"] |= {"itemsizing": "constant"}
    return panel


def whole(values: Array) -> tuple[float, float]:
    """Return the limits of an axis that shows all values, with a margin."""
    low, high = float(np.min(values)), float(np.max(values))
    air = 0.02 * (high - low) or 1.0
    return low - air, high + air


def span(residuals: Sequence[Array], part: float = 0.002) -> tuple[float, float]:
    """Return the limits of an axis for residuals, without the outermost fraction ``part`` at either end."""
    low = min(float(np.quantile(r, part)) for r in residuals)
    high = max(float(np.quantile(r, 1.0 - part)) for r in residuals)
    air = 0.12 * (high - low) or 1.0
    return low - air, high + air


def curve(
    x: Array, y: Array, name: str, unit: Unit, color: str, *, width: float = 1.8, dash: str = "solid", **style: object
) -> Trace:
    """Return a line over a signal.

    Args:
        x: abscissa as shown, shape (n,).
        y: ordinate before conversion, shape (n,).
        name: entry in the legend.
        unit: unit to show y in.
        color: colour of the line.
        width: line width in pixels.
        dash: plotly's name of the pattern.
        style: further keys of plotly's trace.
    """
    style = {"line": {"color": color, "width": width, "dash": dash}} | style
    hover = f"%{{y:,.4~g}} {unit.symbol}<extra></extra>"
    return scatter("lines", packed(x), packed(y * unit.factor), name, hovertemplate=hover) | style
