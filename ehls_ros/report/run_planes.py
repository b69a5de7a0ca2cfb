"""Figures of one run that show one quantity against another, or a distribution.

Each function takes a trajectory and returns a figure, or the reason for its omission.
"""

import numpy as np

from ehls_ros.report.page import LeftOut, Panel, number
from ehls_ros.report.plot import (
    BLACK,
    BLUE,
    CYCLES,
    GREEN,
    MEGAPASCAL,
    MEGAPASCAL_PER_SECOND,
    MICROSECOND,
    MILLIMETRE,
    MILLIMETRE_PER_SECOND,
    NEWTON,
    ORANGE,
    PURPLE,
    VERMILION,
    Axis,
    Trace,
    line,
    packed,
    plane_layout,
    upright,
)
from ehls_ros.report.run_signals import (
    PLANE_SAMPLES,
    WITHOUT_VISCOUS,
    force_unit,
    known,
    largest_of,
    last_samples,
    last_seconds,
    missing_reason,
    missing_together,
    response_of,
    setting,
    several_elements,
    sliding_bound,
)
from ehls_ros.trajectory import Trajectory

RESPONSE_QUANTILES = {"median": 0.5, "99 %": 0.99, "99.9 %": 0.999, "largest": 1.0}


def response_histogram(run: Trajectory) -> Panel | LeftOut:
    """Draw the histogram of the loop's response time, with quantiles."""
    title = "Distribution of the response"
    response = response_of(run)
    if response is None:
        return LeftOut(title, missing_reason(run, "response_s") or "response_s holds no time above zero")
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
    """Draw pressure error against sliding variable, with the region guaranteed by the control law."""
    title = "Sliding plane"
    if missing := missing_together(run, last_samples(run), "e3_pa", "s_pa_s"):
        return LeftOut(title, missing)
    error, sliding = run["e3_pa"] * MEGAPASCAL.factor, run["s_pa_s"]
    start, steady = slice(min(len(run) // 2, PLANE_SAMPLES)), last_samples(run)
    traces = [
        line(error[start], sliding[start], "start", MEGAPASCAL_PER_SECOND, ORANGE, width=1.0),
        line(error[steady], sliding[steady], last_seconds(run), MEGAPASCAL_PER_SECOND, BLUE, width=1.0),
    ]
    width, height = largest_of(error[steady]), largest_of(sliding[steady]) * MEGAPASCAL_PER_SECOND.factor
    area = setting(run.metadata, "rig", "plant", "piston_area")
    bound = sliding_bound(run.metadata)
    if bound is not None and area is not None and known(run, "force_bound_n"):
        half = largest_of(run["force_bound_n"]) / area * MEGAPASCAL.factor
        width, height = max(width, half), max(height, bound * MEGAPASCAL_PER_SECOND.factor)
        corners = np.array([[-half, -bound], [half, -bound], [half, bound], [-half, bound], [-half, -bound]])
        region = line(corners[:, 0], corners[:, 1], "region of (44)", MEGAPASCAL_PER_SECOND, GREEN, width=1.6)
        traces.insert(0, region | {"fill": "toself", "fillcolor": "rgba(0, 158, 115, 0.12)", "hoverinfo": "skip"})
    layout = plane_layout(
        Axis("load pressure error e<sub>3</sub>", MEGAPASCAL, (-1.3 * width, 1.3 * width)),
        Axis("s", MEGAPASCAL_PER_SECOND, (-1.3 * height, 1.3 * height)),
    )
    return Panel(title, traces, layout, height=340, over_time=False)


def friction_against_velocity(run: Trajectory) -> Panel | LeftOut:
    """Draw estimated friction against velocity in the last part of the run."""
    title = "Friction against velocity"
    if missing := missing_together(run, last_samples(run), "friction_gms_n", "velocity_m_s"):
        return LeftOut(title, missing)
    steady = last_samples(run)
    velocity = run["velocity_m_s"][steady] * MILLIMETRE_PER_SECOND.factor
    elements = run["friction_gms_n"][steady]
    traces = []
    if known(run, "friction_viscous_n"):
        total = elements + run["friction_viscous_n"][steady]
        traces.append(line(velocity, total, "with viscous friction", NEWTON, PURPLE, width=1.2))
    label = "all elements" if several_elements(run) else WITHOUT_VISCOUS
    traces.append(line(velocity, elements, label, NEWTON, BLACK, width=1.4))
    layout = plane_layout(Axis("velocity", MILLIMETRE_PER_SECOND), Axis("friction", NEWTON))
    return Panel(title, traces, layout, f"The {last_seconds(run)}.", height=340, over_time=False)


def force_against_position(run: Trajectory) -> Panel | LeftOut:
    """Draw driving force against position in the last part of the run."""
    title = "Force against position"
    if missing := missing_together(run, last_samples(run), "force_n", "position_m"):
        return LeftOut(title, missing)
    steady, unit = last_samples(run), force_unit(run)
    position = run["position_m"][steady] * MILLIMETRE.factor
    traces = [line(position, run["force_n"][steady], "force", unit, BLUE, width=1.3)]
    layout = plane_layout(Axis("position", MILLIMETRE), Axis("force", unit))
    return Panel(title, traces, layout, f"The {last_seconds(run)}.", height=340, over_time=False)
