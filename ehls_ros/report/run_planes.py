"""Figures of one run that show one quantity against another, or a distribution.

Each function takes a trajectory and returns a figure, or the reason for its omission.
"""

import numpy as np

from ehls_ros.report import plot
from ehls_ros.report.page import LeftOut, Panel, number, plane
from ehls_ros.report.plot import MEGAPASCAL, MEGAPASCAL_PER_SECOND, MICROSECOND, NEWTON, Axis, Trace, line
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

RESPONSE_QUANTILES = (
    ("median", 0.5, plot.BLACK, "solid"),
    ("99 %", 0.99, plot.PURPLE, "dash"),
    ("99.9 %", 0.999, plot.ORANGE, "dashdot"),
    ("largest", 1.0, plot.VERMILION, "dot"),
)
"""Name, fraction, colour and pattern of the marked quantiles."""


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
    outline = plot.scatter(
        "lines",
        plot.packed(edges),
        plot.packed(np.append(np.maximum(counts, empty), empty)),
        f"{number(response.size)} cycles",
        line={"color": plot.BLUE, "width": 1, "shape": "hv"},
        fill="tozeroy",
        fillcolor=plot.shade(plot.BLUE, 0.35),
        showlegend=False,
        hovertemplate=f"from %{{x:,.4~g}} {MICROSECOND.symbol}: %{{y:,d}} cycles<extra></extra>",
    )
    quantiles: list[Trace] = []
    for name, part, color, dash in RESPONSE_QUANTILES:
        value = float(np.quantile(response, part))
        label = f"{name} {number(value)} {MICROSECOND.symbol}"
        quantiles.append(plot.upright(value, (empty, top), label, color, dash=dash))
    x = Axis("response", MICROSECOND, (low, 1.05 * high), logarithmic=True)
    return plane(title, [outline, *quantiles], x, Axis("count", plot.CYCLES, (empty, top), logarithmic=True))


def sliding_plane(run: Trajectory) -> Panel | LeftOut:
    """Draw pressure error against sliding variable, with the region guaranteed by the control law."""
    title, unit = "Sliding plane", MEGAPASCAL_PER_SECOND
    if missing := missing_together(run, last_samples(run), "e3_pa", "s_pa_s"):
        return LeftOut(title, missing)
    error, sliding = run["e3_pa"] * MEGAPASCAL.factor, run["s_pa_s"]
    start, steady = slice(min(len(run) // 2, PLANE_SAMPLES)), last_samples(run)
    traces = [
        line(error[start], sliding[start], "start", unit, plot.ORANGE, width=1.0),
        line(error[steady], sliding[steady], last_seconds(run), unit, plot.BLUE, width=1.0),
    ]
    width, height = largest_of(error[steady]), largest_of(sliding[steady]) * unit.factor
    area = setting(run.metadata, "rig", "plant", "piston_area")
    bound = sliding_bound(run.metadata)
    if bound is not None and area is not None and known(run, "force_bound_n"):
        half = largest_of(run["force_bound_n"]) / area * MEGAPASCAL.factor
        width, height = max(width, half), max(height, bound * unit.factor)
        corners = np.array([[-half, -bound], [half, -bound], [half, bound], [-half, bound], [-half, -bound]])
        region = line(corners[:, 0], corners[:, 1], "region of (44)", unit, plot.GREEN, width=1.6)
        traces.insert(0, region | {"fill": "toself", "fillcolor": plot.shade(plot.GREEN, 0.12), "hoverinfo": "skip"})
    x = Axis("load pressure error e<sub>3</sub>", MEGAPASCAL, (-1.3 * width, 1.3 * width))
    return plane(title, traces, x, Axis("s", unit, (-1.3 * height, 1.3 * height)))


def friction_against_velocity(run: Trajectory) -> Panel | LeftOut:
    """Draw estimated friction against velocity in the last part of the run."""
    title, steady = "Friction against velocity", last_samples(run)
    if missing := missing_together(run, steady, "friction_gms_n", "velocity_m_s"):
        return LeftOut(title, missing)
    velocity = run["velocity_m_s"][steady] * plot.VELOCITY.unit.factor
    elements = run["friction_gms_n"][steady]
    traces = []
    if known(run, "friction_viscous_n"):
        total = elements + run["friction_viscous_n"][steady]
        traces.append(line(velocity, total, "with viscous friction", NEWTON, plot.PURPLE, width=1.2))
    label = "all elements" if several_elements(run) else WITHOUT_VISCOUS
    traces.append(line(velocity, elements, label, NEWTON, plot.BLACK, width=1.4))
    return plane(title, traces, plot.VELOCITY, plot.FRICTION, f"The {last_seconds(run)}.")


def force_against_position(run: Trajectory) -> Panel | LeftOut:
    """Draw driving force against position in the last part of the run."""
    title, steady = "Force against position", last_samples(run)
    if missing := missing_together(run, steady, "force_n", "position_m"):
        return LeftOut(title, missing)
    x, y = Axis("position", plot.MILLIMETRE), Axis("force", force_unit(run["force_n"]))
    traces = [line(run["position_m"][steady] * x.unit.factor, run["force_n"][steady], "force", y.unit, plot.BLUE, width=1.3)]
    return plane(title, traces, x, y, f"The {last_seconds(run)}.")
