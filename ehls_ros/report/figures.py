"""The panels of one run: each function takes a trajectory and gives a figure, or says what is missing.

Quantities of the sliding mode law keep the paper's units (MPa, s); everything else is shown in units that
make readable numbers.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report.decimation import part_means
from ehls_ros.report.page import LeftOut, Panel, number
from ehls_ros.report.plot import (
    BLACK,
    BLUE,
    CYCLES,
    GREEN,
    GREY,
    KILONEWTON,
    LIGHT_GREY,
    MEGAPASCAL,
    MICROSECOND,
    MILLIMETRE,
    MILLIMETRE_PER_SECOND,
    NEWTON,
    ORANGE,
    PAPER_PRESSURE,
    PAPER_PRESSURE_RATE,
    PURE_NUMBER,
    PURPLE,
    SKY,
    VERMILION,
    Axis,
    Trace,
    Unit,
    band,
    event_marks,
    limits,
    line,
    packed,
    plane_layout,
    time_layout,
    time_line,
    time_mark,
    upright,
)
from ehls_ros.trajectory import Trajectory

PLANE_SAMPLES = 10_000
"""Samples of a plot of one signal against another: some periods, not a blot."""
RASTER_COLUMNS = 1500
ELEMENT_LINES = ((BLUE, "solid"), (ORANGE, "solid"), (GREEN, "dash"), (SKY, "solid"), (PURPLE, "dash"))
UNUSED_AT_ZERO = frozenset({"e3_mpa", "s_mpa_s", "alpha", "beta", "delta_n", "force_error_n", "force_bound_n"})
"""What a controller without a sliding mode fills with zeros."""
RESPONSE_QUANTILES = {"median": 0.5, "99 %": 0.99, "99.9 %": 0.999, "largest": 1.0}


def force_tracking(run: Trajectory) -> Panel | LeftOut:
    """Draw force and reference, and the disturbance behind them."""
    title = "Force tracking"
    if missing := _missing(run, "force_n"):
        return LeftOut(title, missing)
    time = since_start(run)
    traces: list[Trace] = []
    if known(run, "disturbance_force_n"):
        traces.append(time_line(time, run["disturbance_force_n"], "disturbance", KILONEWTON, ORANGE, width=1.2))
    traces.append(time_line(time, run["force_n"], "force", KILONEWTON, BLUE, width=2.2))
    if known(run, "force_reference_n"):
        reference = run["force_reference_n"]
        traces.append(time_line(time, reference, "reference", KILONEWTON, BLACK, width=1.2, dash="dash"))
    return Panel(title, traces, time_layout(time[-1], [Axis("force", KILONEWTON)]), height=290)


def force_error(run: Trajectory, convergence_s: float | None) -> Panel | LeftOut:
    """Draw the force error inside its bound, scaled to the steady part of the run.

    Args:
        run: the trajectory.
        convergence_s: time since the start at which the error had converged [s]; None if it did not.
    """
    title = "Force error"
    error = error_of(run)
    if error is None:
        return LeftOut(title, _missing_together(run, slice(None), "force_reference_n", "force_n"))
    time = since_start(run)
    traces: list[Trace] = []
    bound = 0.0
    if known(run, "force_bound_n"):
        bound = _largest(run["force_bound_n"])
        traces += band(time, run["force_bound_n"], "bound (44)", NEWTON)
    traces.append(time_line(time, error, "force − reference", NEWTON, BLUE))
    if convergence_s:
        traces.append(time_mark(convergence_s, f"converged after {number(convergence_s)} s"))
    span, note = steady_span(error, bound, NEWTON.symbol)
    return Panel(title, traces, time_layout(time[-1], [Axis("error", NEWTON, span)]), note, height=280)


def valve(run: Trajectory) -> Panel | LeftOut:
    """Draw spool command and spool between the limits of the rig."""
    title = "Valve"
    if not known(run, "valve_command_m") and not known(run, "spool_m"):
        return LeftOut(title, _missing(run, "valve_command_m", "spool_m"))
    time = since_start(run)
    traces: list[Trace] = []
    largest = 0.0
    for name, label, color in (("valve_command_m", "command", SKY), ("spool_m", "spool", BLUE)):
        if known(run, name):
            traces.append(time_line(time, run[name], label, MILLIMETRE, color))
            largest = max(largest, _largest(run[name]))
    limit = np.full(time.shape, setting(run.metadata, "rig", "limits", "spool") or np.nan)
    lines, note = _limits(time, limit, largest, "limit of the spool", MILLIMETRE)
    traces += lines
    if known(run, "saturated"):
        traces += event_marks(time, run["saturated"] > 0.5, "command cut at its limit", VERMILION)
    return Panel(title, traces, time_layout(time[-1], [Axis("spool displacement", MILLIMETRE)]), note)


def load_pressure(run: Trajectory) -> Panel | LeftOut:
    """Draw the load pressure between plus and minus the supply pressure."""
    title = "Load pressure"
    if missing := _missing(run, "load_pressure_pa"):
        return LeftOut(title, missing)
    time = since_start(run)
    traces = [time_line(time, run["load_pressure_pa"], "load pressure", MEGAPASCAL, BLUE)]
    if known(run, "supply_pressure_pa"):
        supply, name = run["supply_pressure_pa"], "supply pressure"
    else:
        nominal = setting(run.metadata, "rig", "plant", "supply_pressure")
        supply, name = np.full(time.shape, nominal or np.nan), "nominal supply pressure"
    lines, note = _limits(time, supply, _largest(run["load_pressure_pa"]), name, MEGAPASCAL)
    return Panel(title, [*traces, *lines], time_layout(time[-1], [Axis("pressure", MEGAPASCAL)]), note)


def motion(run: Trajectory) -> Panel | LeftOut:
    """Draw position and velocity of the piston with what they follow, and the displacement the position servo made."""
    title = "Motion"
    if not known(run, "position_m") and not known(run, "velocity_m_s"):
        return LeftOut(title, _missing(run, "position_m", "velocity_m_s"))
    time = since_start(run)
    traces: list[Trace] = []
    rows: list[Axis] = []
    if known(run, "position_m"):
        rows.append(Axis("position", MILLIMETRE))
        traces.append(time_line(time, run["position_m"], "piston position", MILLIMETRE, BLUE))
        servo = run.signals.get("disturbance_displacement_m", np.zeros(1))
        if _largest(servo) > 0:
            traces.append(time_line(time, servo, "position servo", MILLIMETRE, ORANGE, width=1.2))
        if known(run, "position_reference_m"):
            reference = run["position_reference_m"]
            traces.append(time_line(time, reference, "position reference", MILLIMETRE, BLACK, width=1.2, dash="dash"))
    if known(run, "velocity_m_s"):
        rows.append(Axis("velocity", MILLIMETRE_PER_SECOND))
        velocity = run["velocity_m_s"]
        traces.append(time_line(time, velocity, "piston velocity", MILLIMETRE_PER_SECOND, GREEN, row=len(rows)))
        if known(run, "position_reference_rate_m_s"):
            rate, unit = run["position_reference_rate_m_s"], MILLIMETRE_PER_SECOND
            traces.append(time_line(time, rate, "velocity reference", unit, BLACK, row=len(rows), width=1.2, dash="dash"))
    return Panel(title, traces, time_layout(time[-1], rows), height=160 + 90 * len(rows))


def position_error(run: Trajectory) -> Panel | LeftOut:
    """Draw the position error, scaled to the steady part of the run."""
    title = "Position error"
    if missing := _missing_together(run, slice(None), "position_reference_m", "position_m"):
        return LeftOut(title, missing)
    time = since_start(run)
    with np.errstate(invalid="ignore"):
        error = run["position_m"] - run["position_reference_m"]
    traces = [time_line(time, error, "position − reference", MILLIMETRE, BLUE)]
    span, note = steady_span(error * MILLIMETRE.factor, 0.0, MILLIMETRE.symbol)
    return Panel(title, traces, time_layout(time[-1], [Axis("error", MILLIMETRE, span)]), note, height=280)


def friction(run: Trajectory) -> Panel | LeftOut:
    """Draw the estimated friction, and of several elements each, with when it slips."""
    title = "Estimated friction"
    parts = ("friction_gms_n", "friction_viscous_n", "friction_elements_n")
    if not any(known(run, name) for name in parts):
        return LeftOut(title, _missing(run, *parts))
    time = since_start(run)
    traces: list[Trace] = []
    rows: list[Axis] = []
    several = _several_elements(run)
    if known(run, "friction_gms_n") or known(run, "friction_viscous_n"):
        rows.append(Axis("friction", NEWTON, share=2.0))
    for name, label, color, width in (
        ("friction_viscous_n", "viscous", PURPLE, 1.5),
        ("friction_gms_n", "all elements" if several else WITHOUT_VISCOUS, BLACK, 1.8),
    ):
        if known(run, name):
            traces.append(time_line(time, run[name], label, NEWTON, color, width=width))
    if known(run, "friction_elements_n") and (several or not rows):
        rows.append(Axis("each element", NEWTON, share=2.0))
        for index, force in enumerate(_columns(run["friction_elements_n"])):
            color, dash = ELEMENT_LINES[index % len(ELEMENT_LINES)]
            label = f"element {index + 1}"
            traces.append(time_line(time, force, label, NEWTON, color, row=len(rows), dash=dash))
    if known(run, "friction_fallback"):
        traces += event_marks(time, run["friction_fallback"] > 0.5, "steady friction stood in", VERMILION)
    note = ""
    if several and known(run, "friction_slipping"):
        slipping = run["friction_slipping"].reshape(len(run), -1)
        names = tuple(str(index + 1) for index in range(slipping.shape[1]))
        rows.append(Axis("element", PURE_NUMBER, (len(names) + 0.5, 0.5), share=1.3, names=names))
        traces += _raster(time, slipping, row=len(rows))
        note = _slip_together(slipping)
    return Panel(title, traces, time_layout(time[-1], rows), note, height=150 + 100 * len(rows))


def adaptation(run: Trajectory) -> Panel | LeftOut:
    """Draw what the controller adapts: the scales of friction and the remaining disturbance."""
    title = "Adaptation"
    if not any(known(run, name) for name in ("alpha", "beta", "delta_n")):
        return LeftOut(title, _missing(run, "alpha", "beta", "delta_n"))
    time = since_start(run)
    traces: list[Trace] = []
    rows: list[Axis] = []
    if known(run, "alpha") or known(run, "beta"):
        rows.append(Axis("scale", PURE_NUMBER))
    for name, label, color in (("alpha", "α̂, friction elements", BLUE), ("beta", "β̂, viscous friction", VERMILION)):
        if known(run, name):
            traces.append(time_line(time, run[name], label, PURE_NUMBER, color))
    if known(run, "delta_n"):
        rows.append(Axis("D̂", KILONEWTON))
        label = "D̂, remaining disturbance"
        traces.append(time_line(time, run["delta_n"], label, KILONEWTON, GREEN, row=len(rows)))
    return Panel(title, traces, time_layout(time[-1], rows), height=160 + 80 * len(rows))


def sliding_variable(run: Trajectory) -> Panel | LeftOut:
    """Draw the sliding variable inside its bound b/h, scaled to the steady part of the run."""
    title = "Sliding variable"
    if missing := _missing(run, "s_mpa_s"):
        return LeftOut(title, missing)
    time = since_start(run)
    traces: list[Trace] = []
    bound = sliding_bound(run.metadata)
    if bound is not None:
        label = f"bound ±b/h = ±{number(bound)} {PAPER_PRESSURE_RATE.symbol}"
        traces += band(time, np.full(time.shape, bound), label, PAPER_PRESSURE_RATE)
    traces.append(time_line(time, run["s_mpa_s"], "s", PAPER_PRESSURE_RATE, BLUE))
    span, note = steady_span(run["s_mpa_s"], bound or 0.0, PAPER_PRESSURE_RATE.symbol)
    return Panel(title, traces, time_layout(time[-1], [Axis("s", PAPER_PRESSURE_RATE, span)]), note)


def response_time(run: Trajectory) -> Panel | LeftOut:
    """Draw the time from snapshot to command over the run, with the missed cycles."""
    title = "Response of the loop"
    response = _response(run)
    if response is None:
        return LeftOut(title, _missing(run, "response_s") or "response_s holds no time above zero")
    time = since_start(run)
    span = float(np.nanmin(response)), float(np.nanmax(response))
    traces = [time_line(time, response, "snapshot to command", MICROSECOND, BLUE, width=1.0)]
    if len(run) > 1:
        period = float(np.median(np.diff(run.time_s)))
        span = min(span[0], period), max(span[1], period)
        label = f"period {number(period * MICROSECOND.factor)} {MICROSECOND.symbol}"
        traces.append(time_line(time, np.full(time.shape, period), label, MICROSECOND, GREY, dash="dash"))
    if "valve_command_m" in run:
        traces += event_marks(time, ~np.isfinite(run["valve_command_m"]), "missed cycles", VERMILION)
    shown = 0.9 * span[0] * MICROSECOND.factor, 1.4 * span[1] * MICROSECOND.factor
    rows = [Axis("response", MICROSECOND, shown, logarithmic=True)]
    note = {
        "lockstep": "The plant waited for every answer, so a late one costs time and not accuracy.",
        "realtime": "The plant did not wait: past the period it held the last command.",
    }.get(str(run.metadata.get("timing")), "")
    return Panel(title, traces, time_layout(time[-1], rows), note)


def response_histogram(run: Trajectory) -> Panel | LeftOut:
    """Draw how often the loop took how long, with the quantiles."""
    title = "Distribution of the response"
    response = _response(run)
    if response is None:
        return LeftOut(title, _missing(run, "response_s") or "response_s holds no time above zero")
    response = response[np.isfinite(response)] * MICROSECOND.factor
    low, high = float(response.min()) * 0.95, float(response.max()) * 1.05
    counts, edges = np.histogram(response, bins=np.geomspace(low, high, 80))
    empty, top = 0.5, 2.0 * float(counts.max())
    outline: Trace = {
        "type": "scatter",
        "mode": "lines",
        "x": packed(edges),
        "y": packed(np.append(np.maximum(counts, empty), empty)),
        "line": {"color": BLUE, "width": 1, "shape": "hv"},
        "fill": "tozeroy",
        "fillcolor": "rgba(0, 114, 178, 0.35)",
        "name": f"{number(response.size)} cycles",
        "showlegend": False,
        "hovertemplate": f"from %{{x:,.4~g}} {MICROSECOND.symbol}: %{{y:,d}} cycles<extra></extra>",
    }
    quantiles: list[Trace] = []
    for (name, part), color, dash in zip(
        RESPONSE_QUANTILES.items(), (BLACK, PURPLE, ORANGE, VERMILION), ("solid", "dash", "dashdot", "dot"), strict=True
    ):
        value = float(np.quantile(response, part))
        quantiles.append(upright(value, (empty, top), f"{name} {number(value)} {MICROSECOND.symbol}", color, dash=dash))
    layout = plane_layout(
        Axis("response", MICROSECOND, (low, 1.05 * high), logarithmic=True),
        Axis("count", CYCLES, (empty, top), logarithmic=True),
    )
    return Panel(title, [outline, *quantiles], layout, height=340, over_time=False)


def sliding_plane(run: Trajectory) -> Panel | LeftOut:
    """Draw pressure error against sliding variable around the region the law promises to reach."""
    title = "Sliding plane"
    if missing := _missing_together(run, _last_samples(run), "e3_mpa", "s_mpa_s"):
        return LeftOut(title, missing)
    error, sliding = run["e3_mpa"], run["s_mpa_s"]
    start, steady = slice(min(len(run) // 2, PLANE_SAMPLES)), _last_samples(run)
    traces = [
        line(error[start], sliding[start], "start", PAPER_PRESSURE_RATE, ORANGE, width=1.0),
        line(error[steady], sliding[steady], _last_seconds(run), PAPER_PRESSURE_RATE, BLUE, width=1.0),
    ]
    width, height = _largest(error[steady]), _largest(sliding[steady])
    area = setting(run.metadata, "rig", "plant", "piston_area")
    bound = sliding_bound(run.metadata)
    if bound is not None and area is not None and known(run, "force_bound_n"):
        half = _largest(run["force_bound_n"]) / area * MEGAPASCAL.factor
        width, height = max(width, half), max(height, bound)
        corners = np.array([[-half, -bound], [half, -bound], [half, bound], [-half, bound], [-half, -bound]])
        region = line(corners[:, 0], corners[:, 1], "region of (44)", PAPER_PRESSURE_RATE, GREEN, width=1.6)
        traces.insert(0, region | {"fill": "toself", "fillcolor": "rgba(0, 158, 115, 0.12)", "hoverinfo": "skip"})
    layout = plane_layout(
        Axis("load pressure error e<sub>3</sub>", PAPER_PRESSURE, (-1.3 * width, 1.3 * width)),
        Axis("s", PAPER_PRESSURE_RATE, (-1.3 * height, 1.3 * height)),
    )
    return Panel(title, traces, layout, height=340, over_time=False)


def friction_against_velocity(run: Trajectory) -> Panel | LeftOut:
    """Draw estimated friction against velocity in the last part of the run."""
    title = "Friction against velocity"
    if missing := _missing_together(run, _last_samples(run), "friction_gms_n", "velocity_m_s"):
        return LeftOut(title, missing)
    steady = _last_samples(run)
    velocity = run["velocity_m_s"][steady] * MILLIMETRE_PER_SECOND.factor
    elements = run["friction_gms_n"][steady]
    traces = []
    if known(run, "friction_viscous_n"):
        total = elements + run["friction_viscous_n"][steady]
        traces.append(line(velocity, total, "with viscous friction", NEWTON, PURPLE, width=1.2))
    label = "all elements" if _several_elements(run) else WITHOUT_VISCOUS
    traces.append(line(velocity, elements, label, NEWTON, BLACK, width=1.4))
    layout = plane_layout(Axis("velocity", MILLIMETRE_PER_SECOND), Axis("friction", NEWTON))
    return Panel(title, traces, layout, f"The {_last_seconds(run)}.", height=340, over_time=False)


def force_against_position(run: Trajectory) -> Panel | LeftOut:
    """Draw driving force against position in the last part of the run."""
    title = "Force against position"
    if missing := _missing_together(run, _last_samples(run), "force_n", "position_m"):
        return LeftOut(title, missing)
    steady = _last_samples(run)
    position = run["position_m"][steady] * MILLIMETRE.factor
    traces = [line(position, run["force_n"][steady], "force", KILONEWTON, BLUE, width=1.3)]
    layout = plane_layout(Axis("position", MILLIMETRE), Axis("force", KILONEWTON))
    return Panel(title, traces, layout, f"The {_last_seconds(run)}.", height=340, over_time=False)


def known(run: Trajectory, name: str) -> bool:
    """Tell whether a signal was recorded and says something."""
    return not _absence(run, name)


def since_start(run: Trajectory) -> NDArray[np.float64]:
    """Give the time since the start [s], shape (n,)."""
    time: NDArray[np.float64] = run.time_s - run.time_s[0]
    return time


def error_of(run: Trajectory) -> NDArray[np.float64] | None:
    """Give force minus reference [N], shape (n,), measured rather than as the controller saw it; None if unknown."""
    if "force_n" in run and "force_reference_n" in run:
        with np.errstate(invalid="ignore"):
            error: NDArray[np.float64] = run["force_n"] - run["force_reference_n"]
        if np.isfinite(error).any():
            return error
    return run["force_error_n"] if known(run, "force_error_n") else None


def setting(metadata: Mapping[str, Any], *keys: str) -> float | None:
    """Look a number up in the configuration; None if it does not stand there.

    Args:
        metadata: a trajectory's metadata.
        keys: way down to the number.
    """
    value: Any = metadata
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    usable = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None


def sliding_bound(metadata: Mapping[str, Any]) -> float | None:
    """Give the bound b/h of the sliding variable [MPa/s]; None if the controller has none."""
    b, h = setting(metadata, "spec", "controller", "b"), setting(metadata, "spec", "controller", "h")
    return b / h if b is not None and h else None


def steady_span(values: NDArray[np.float64], bound: float, unit: str) -> tuple[tuple[float, float] | None, str]:
    """Scale an axis to the last half of a run, unless its start is hardly larger.

    Args:
        values: the signal as shown, shape (n,).
        bound: what has to be in the picture as well.
        unit: symbol of the unit shown.

    Returns:
        Ends of the axis, None to fit the data, and the note that goes with them.
    """
    whole = _largest(values)
    steady = 1.25 * max(_largest(values[len(values) // 2 :]), bound)
    if whole <= 1.5 * steady or steady == 0:
        return None, ""
    return (-steady, steady), f"Scaled to the steady part; the largest of the whole run is {number(whole)} {unit}."


def _absence(run: Trajectory, name: str) -> str:
    if name not in run:
        return "not been recorded"
    values = run[name][np.isfinite(run[name])]
    if not values.size:
        return "no values"
    return "no values but zero" if name in UNUSED_AT_ZERO and not values.any() else ""


def _missing(run: Trajectory, *names: str) -> str:
    reasons: dict[str, list[str]] = {}
    for name in names:
        if absence := _absence(run, name):
            reasons.setdefault(absence, []).append(name)
    return ", ".join(
        f"{' and '.join(which)} {'has' if len(which) == 1 else 'have'} {absence}" for absence, which in reasons.items()
    )


def _missing_together(run: Trajectory, samples: slice, *names: str) -> str:
    if missing := _missing(run, *names):
        return missing
    together = np.logical_and.reduce([np.isfinite(run[name][samples]) for name in names])
    return "" if together.any() else f"no cycle to be shown holds both {' and '.join(names)}"


WITHOUT_VISCOUS = "without viscous friction"
"""What the elements' force is called where there is one element only."""


def _several_elements(run: Trajectory) -> bool:
    """Tell whether a run's friction estimate has more than one element."""
    return any(known(run, name) and len(_columns(run[name])) > 1 for name in ("friction_elements_n", "friction_slipping"))


def _columns(values: NDArray[np.float64]) -> NDArray[np.float64]:
    columns: NDArray[np.float64] = values.reshape(len(values), -1).T
    return columns


def _response(run: Trajectory) -> NDArray[np.float64] | None:
    if not known(run, "response_s"):
        return None
    # a logarithmic axis has no place for the zero of a loop that was not timed
    response = np.where(np.isfinite(run["response_s"]) & (run["response_s"] > 0), run["response_s"], np.nan)
    return response if np.isfinite(response).any() else None


def _largest(values: NDArray[np.float64]) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if known.size else 0.0


def _limits(
    time: NDArray[np.float64], limit: NDArray[np.float64], largest: float, name: str, unit: Unit
) -> tuple[list[Trace], str]:
    """Draw a limit unless it is so far away that the signal would become a flat line."""
    if not np.isfinite(limit).any():
        return [], ""
    if _largest(limit) > 2.5 * largest:
        shown = number(_largest(limit) * unit.factor)
        return [], f"The {name}, ±{shown} {unit.symbol}, lies outside the picture."
    return limits(time, limit, f"± {name}", unit), ""


def _last_samples(run: Trajectory) -> slice:
    return slice(len(run) - min(len(run) - len(run) // 2, PLANE_SAMPLES), len(run))


def _last_seconds(run: Trajectory) -> str:
    return f"last {number(float(run.time_s[-1] - run.time_s[_last_samples(run).start]), 2)} s"


def _raster(time: NDArray[np.float64], slipping: NDArray[np.float64], row: int) -> list[Trace]:
    parts = min(RASTER_COLUMNS, len(time))
    cells = np.stack([part_means(values, parts) for values in _columns(slipping)])
    colors = {"sticks": LIGHT_GREY, "slips": SKY}
    raster: Trace = {
        "type": "heatmap",
        "x": packed(part_means(time, parts)),
        "y": list(range(1, len(cells) + 1)),
        "z": packed(cells),
        "yaxis": f"y{row}",
        "zmin": 0,
        "zmax": 1,
        "colorscale": [[0, colors["sticks"]], [1, colors["slips"]]],
        "showscale": False,
        "ygap": 2,
        "hoverinfo": "skip",
    }
    keys = [
        {
            "type": "scatter",
            "mode": "markers",
            "x": [None],
            "y": [None],
            "name": name,
            "marker": {"symbol": "square", "size": 11, "color": color},
        }
        for name, color in colors.items()
    ]
    return [raster, *keys]


def _slip_together(slipping: NDArray[np.float64]) -> str:
    known = slipping[np.isfinite(slipping).all(axis=1)] > 0.5
    if known.shape[1] < 2 or not known.any():
        return ""
    together = float(np.mean(known.all(axis=1) == known.any(axis=1)))
    remark = "All elements stick or slip together in "
    return f"{remark}{number(100 * together)} % of the cycles{', as one element would' if together > 0.95 else ''}."
