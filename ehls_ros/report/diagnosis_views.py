"""Selection of the best view of an error: a residual, and the signal to draw it against."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.result import Cause, ChannelTrace, Diagnosis
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Group

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
