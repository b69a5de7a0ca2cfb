"""Figures of one run over time: each function takes a trajectory and returns a figure, or the reason for its omission.

Quantities of the sliding mode law keep the paper's units (MPa, s).
"""

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report.decimation import part_means
from ehls_ros.report.page import LeftOut, Panel, number
from ehls_ros.report.plot import (
    BLACK,
    BLUE,
    ELEMENT_LINES,
    GREEN,
    GREY,
    KILONEWTON,
    LIGHT_GREY,
    MEGAPASCAL,
    MEGAPASCAL_PER_SECOND,
    MICROSECOND,
    MILLIMETRE,
    MILLIMETRE_PER_SECOND,
    NEWTON,
    ORANGE,
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
    packed,
    time_layout,
    time_line,
    time_mark,
)
from ehls_ros.report.run_signals import (
    WITHOUT_VISCOUS,
    columns_of,
    error_of,
    force_unit,
    known,
    largest_of,
    missing_reason,
    missing_together,
    response_of,
    setting,
    several_elements,
    since_start,
    sliding_bound,
)
from ehls_ros.trajectory import Trajectory

RASTER_COLUMNS = 1500


def force_tracking(run: Trajectory) -> Panel | LeftOut:
    """Draw force and reference, and the disturbance behind them."""
    title = "Force"
    if missing := missing_reason(run, "force_n"):
        return LeftOut(title, missing)
    time, unit = since_start(run), force_unit(run)
    traces: list[Trace] = []
    if known(run, "disturbance_force_n"):
        traces.append(time_line(time, run["disturbance_force_n"], "disturbance", unit, ORANGE, width=1.2))
    traces.append(time_line(time, run["force_n"], "force", unit, BLUE, width=2.2))
    if known(run, "force_reference_n"):
        reference = run["force_reference_n"]
        traces.append(time_line(time, reference, "reference", unit, BLACK, width=1.2, dash="dash"))
    return Panel(title, traces, time_layout(time[-1], [Axis("force", unit)]), height=290)


def force_error(run: Trajectory, convergence_s: float | None) -> Panel | LeftOut:
    """Draw the force error inside its bound, scaled to the steady part of the run.

    Args:
        run: the trajectory.
        convergence_s: time since the start at which the error had converged [s]; None if it did not.
    """
    title = "Force error"
    error = error_of(run)
    if error is None:
        return LeftOut(title, missing_together(run, slice(None), "force_reference_n", "force_n"))
    time = since_start(run)
    traces: list[Trace] = []
    bound = 0.0
    if known(run, "force_bound_n"):
        bound = largest_of(run["force_bound_n"])
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
        return LeftOut(title, missing_reason(run, "valve_command_m", "spool_m"))
    time = since_start(run)
    traces: list[Trace] = []
    largest = 0.0
    for name, label, color in (("valve_command_m", "command", SKY), ("spool_m", "spool", BLUE)):
        if known(run, name):
            traces.append(time_line(time, run[name], label, MILLIMETRE, color))
            largest = max(largest, largest_of(run[name]))
    limit = np.full(time.shape, setting(run.metadata, "rig", "limits", "spool") or np.nan)
    lines, note = _limits(time, limit, largest, "limit of the spool", MILLIMETRE)
    traces += lines
    if known(run, "saturated"):
        traces += event_marks(time, run["saturated"] > 0.5, "command cut at its limit", VERMILION)
    return Panel(title, traces, time_layout(time[-1], [Axis("spool displacement", MILLIMETRE)]), note)


def load_pressure(run: Trajectory) -> Panel | LeftOut:
    """Draw the load pressure between plus and minus the supply pressure."""
    title = "Load pressure"
    if missing := missing_reason(run, "load_pressure_pa"):
        return LeftOut(title, missing)
    time = since_start(run)
    traces = [time_line(time, run["load_pressure_pa"], "load pressure", MEGAPASCAL, BLUE)]
    if known(run, "supply_pressure_pa"):
        supply, name = run["supply_pressure_pa"], "supply pressure"
    else:
        nominal = setting(run.metadata, "rig", "plant", "supply_pressure")
        supply, name = np.full(time.shape, nominal or np.nan), "nominal supply pressure"
    lines, note = _limits(time, supply, largest_of(run["load_pressure_pa"]), name, MEGAPASCAL)
    return Panel(title, [*traces, *lines], time_layout(time[-1], [Axis("pressure", MEGAPASCAL)]), note)


def motion(run: Trajectory) -> Panel | LeftOut:
    """Draw position and velocity of the piston with their references, and the displacement of the position servo."""
    title = "Motion"
    if not known(run, "position_m") and not known(run, "velocity_m_s"):
        return LeftOut(title, missing_reason(run, "position_m", "velocity_m_s"))
    time = since_start(run)
    traces: list[Trace] = []
    rows: list[Axis] = []
    if known(run, "position_m"):
        rows.append(Axis("position", MILLIMETRE))
        traces.append(time_line(time, run["position_m"], "piston position", MILLIMETRE, BLUE))
        servo = run.signals.get("disturbance_displacement_m", np.zeros(1))
        if largest_of(servo) > 0:
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
    if missing := missing_together(run, slice(None), "position_reference_m", "position_m"):
        return LeftOut(title, missing)
    time = since_start(run)
    with np.errstate(invalid="ignore"):
        error = run["position_m"] - run["position_reference_m"]
    traces = [time_line(time, error, "position − reference", MILLIMETRE, BLUE)]
    span, note = steady_span(error * MILLIMETRE.factor, 0.0, MILLIMETRE.symbol)
    return Panel(title, traces, time_layout(time[-1], [Axis("error", MILLIMETRE, span)]), note, height=280)


def friction(run: Trajectory) -> Panel | LeftOut:
    """Draw the estimated friction, with several elements also the force and slip state of each."""
    title = "Estimated friction"
    parts = ("friction_gms_n", "friction_viscous_n", "friction_elements_n")
    if not any(known(run, name) for name in parts):
        return LeftOut(title, missing_reason(run, *parts))
    time = since_start(run)
    traces: list[Trace] = []
    rows: list[Axis] = []
    several = several_elements(run)
    if known(run, "friction_gms_n") or known(run, "friction_viscous_n"):
        rows.append(Axis("friction", NEWTON, share=2.0))
    for name, label, color, width in (
        ("friction_viscous_n", "viscous", PURPLE, 1.5),
        ("friction_gms_n", "all elements" if several else WITHOUT_VISCOUS, BLACK, 1.8),
    ):
        if known(run, name):
            traces.append(time_line(time, run[name], label, NEWTON, color, width=width))
    if several and known(run, "friction_elements_n"):
        rows.append(Axis("each element", NEWTON, share=2.0))
        for index, force in enumerate(columns_of(run["friction_elements_n"])):
            color, dash = ELEMENT_LINES[index % len(ELEMENT_LINES)]
            label = f"element {index + 1}"
            traces.append(time_line(time, force, label, NEWTON, color, row=len(rows), dash=dash))
    if known(run, "friction_fallback"):
        traces += event_marks(time, run["friction_fallback"] > 0.5, "steady friction in use", VERMILION)
    note = ""
    if several and known(run, "friction_slipping"):
        slipping = run["friction_slipping"].reshape(len(run), -1)
        names = tuple(str(index + 1) for index in range(slipping.shape[1]))
        rows.append(Axis("element", PURE_NUMBER, (len(names) + 0.5, 0.5), share=1.3, names=names))
        traces += _raster(time, slipping, row=len(rows))
        note = _slip_together(slipping)
    return Panel(title, traces, time_layout(time[-1], rows), note, height=150 + 100 * len(rows))


def adaptation(run: Trajectory) -> Panel | LeftOut:
    """Draw the adapted quantities: the scales of friction and the remaining disturbance."""
    title = "Adaptation"
    if not any(known(run, name) for name in ("alpha", "beta", "delta_n")):
        return LeftOut(title, missing_reason(run, "alpha", "beta", "delta_n"))
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
    if known(run, "at_bound"):
        traces += event_marks(time, run["at_bound"] > 0.5, "estimate at its bound", VERMILION)
    return Panel(title, traces, time_layout(time[-1], rows), height=160 + 80 * len(rows))


def sliding_variable(run: Trajectory) -> Panel | LeftOut:
    """Draw the sliding variable inside its bound b/h, scaled to the steady part of the run."""
    title = "Sliding variable"
    if missing := missing_reason(run, "s_pa_s"):
        return LeftOut(title, missing)
    time, unit = since_start(run), MEGAPASCAL_PER_SECOND
    traces: list[Trace] = []
    bound = sliding_bound(run.metadata)
    if bound is not None:
        label = f"bound ±b/h = ±{number(bound * unit.factor)} {unit.symbol}"
        traces += band(time, np.full(time.shape, bound), label, unit)
    traces.append(time_line(time, run["s_pa_s"], "s", unit, BLUE))
    span, note = steady_span(run["s_pa_s"] * unit.factor, (bound or 0.0) * unit.factor, unit.symbol)
    return Panel(title, traces, time_layout(time[-1], [Axis("s", unit, span)]), note)


def response_time(run: Trajectory) -> Panel | LeftOut:
    """Draw the time from snapshot to command over the run, with the missed cycles."""
    title = "Response of the loop"
    response = response_of(run)
    if response is None:
        return LeftOut(title, missing_reason(run, "response_s") or "response_s holds no time above zero")
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
        "lockstep": "The plant waited for every answer: a late one costs time, not accuracy.",
        "realtime": "The plant did not wait: after one period it held the last command.",
    }.get(str(run.metadata.get("timing")), "")
    return Panel(title, traces, time_layout(time[-1], rows), note)


def steady_span(values: NDArray[np.float64], bound: float, unit: str) -> tuple[tuple[float, float] | None, str]:
    """Scale an axis to the last half of a run, unless its start is hardly larger.

    Args:
        values: the signal as shown, shape (n,).
        bound: magnitude that must lie within the axis.
        unit: symbol of the unit shown.

    Returns:
        Limits of the axis, None to fit the data, and a note on the scaling.
    """
    largest = largest_of(values)
    steady = 1.25 * max(largest_of(values[len(values) // 2 :]), bound)
    if largest <= 1.5 * steady or steady == 0:
        return None, ""
    return (-steady, steady), f"Scaled to the steady part; the largest value of the run is {number(largest)} {unit}."


def _limits(
    time: NDArray[np.float64], limit: NDArray[np.float64], largest: float, name: str, unit: Unit
) -> tuple[list[Trace], str]:
    """Draw a limit, unless it is so far away that the signal would become a flat line."""
    if not np.isfinite(limit).any():
        return [], ""
    if largest_of(limit) > 2.5 * largest:
        shown = number(largest_of(limit) * unit.factor)
        return [], f"The {name}, ±{shown} {unit.symbol}, is outside the figure."
    return limits(time, limit, f"± {name}", unit), ""


def _raster(time: NDArray[np.float64], slipping: NDArray[np.float64], row: int) -> list[Trace]:
    parts = min(RASTER_COLUMNS, len(time))
    cells = np.stack([part_means(values, parts) for values in columns_of(slipping)])
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
