"""Figures of the identification report: each function returns a panel, or the reason for its omission."""

import math

import numpy as np

from ehls_ros.arrays import Array, in_python
from ehls_ros.identification.balance import linear_columns
from ehls_ros.identification.motion import Motion
from ehls_ros.identification.result import Identification
from ehls_ros.identification.static import StaticFit
from ehls_ros.identification.stribeck import StaticFriction, steady_force
from ehls_ros.report import plot
from ehls_ros.report.identification_findings import elements_remark
from ehls_ros.report.page import LeftOut, Panel, Rows, number, plane
from ehls_ros.report.plot import (
    BLACK,
    BLUE,
    GREEN,
    MILLIMETRE,
    NEWTON,
    PURE_NUMBER,
    VELOCITY,
    VERMILION,
    Axis,
    Trace,
    dots,
    line,
)
from ehls_ros.report.quantities import as_shown
from ehls_ros.samples import Mask

CURVE_POINTS = 400
"""Number of points of a curve on each side of standstill."""

FLAT = 0.02
"""Remaining fraction of the Stribeck curve's rise at the end of the low-speed range."""

LOOP_BLOCKS = 4000
"""Maximum number of blocks of a recording drawn as a hysteresis loop."""

EXCERPT = 1500
"""Number of blocks of a recording for which the joint fit is shown."""

POINTS = 3000
"""Maximum number of residuals of a recording drawn as a scatter plot."""

WAYS = ((1.0, "forwards", BLUE, "circle"), (-1.0, "backwards", plot.PURPLE, "diamond-open"))
RECORDING_COLORS = (plot.SKY, plot.ORANGE, GREEN, plot.PURPLE, VERMILION)
SPEED = Axis("speed", VELOCITY.unit)


def _curves(found: Identification, static: StaticFit, velocity: Array) -> list[Trace]:
    """Draw the fitted curves of steady sliding at velocities other than zero [m/s]."""
    at = velocity * VELOCITY.unit.factor
    known, friction = found.rig.plant.viscous_damping, found.rig.friction
    level = in_python(found.rig.friction_law.level)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        curve = steady_force(velocity, static.friction)
        steady = np.sign(velocity) * np.array([level(v, friction) for v in velocity.tolist()])
    joint = steady + (known + float(friction.viscous_coefficient)) * velocity
    without_viscous = curve - static.friction.viscous_coefficient * velocity
    return [
        line(at, curve + known * velocity, "static fit", NEWTON, VERMILION, width=1.8),
        line(at, without_viscous, "without the viscous part", NEWTON, GREEN, width=1.5, dash="dash"),
        line(at, joint, "joint fit", NEWTON, BLACK, width=1.2, dash="dot"),
    ]


def _by_way(static: StaticFit, force: Array, chosen: Mask) -> list[tuple[Mask, Trace]]:
    """Draw some classes of the data over speed, each direction with the rows that it shows."""
    traces: list[tuple[Mask, Trace]] = []
    for way, name, color, symbol in WAYS:
        shown = (way * static.velocity > 0.0) & chosen
        if shown.any():
            speed = np.abs(static.velocity[shown]) * SPEED.unit.factor
            traces.append((shown, dots(speed, force[shown], name, NEWTON, color, symbol=symbol, size=6)))
    return traces


def stribeck(found: Identification) -> Panel | LeftOut:
    """Draw steady friction against velocity: the classes of the data and the fitted curves."""
    static = found.static
    if static is None:
        return LeftOut("Stribeck curve", _NO_STATIC)
    fastest = float(np.max(np.abs(static.velocity)))
    side = np.geomspace(1e-4 * fastest, fastest, CURVE_POINTS)
    velocity = np.concatenate([-side[::-1], [np.nan], side])
    at = static.velocity * VELOCITY.unit.factor
    classes = dots(at, static.force, "data, classes of velocity", NEWTON, BLUE, size=6)
    note = f"{number(len(static.velocity))} classes; spring and constant force are subtracted."
    return plane("Stribeck curve", [classes, *_curves(found, static, velocity)], VELOCITY, plot.FRICTION, note, 400)


def stribeck_slow(found: Identification) -> Panel | LeftOut:
    """Draw the Stribeck curve at low speed, both directions on top of each other."""
    title, static = "Stribeck curve at low speed", found.static
    if static is None:
        return LeftOut(title, _NO_STATIC)
    speed = np.abs(static.velocity)
    end = _low_end(static.friction, speed)
    classes = [trace for _, trace in _by_way(static, np.sign(static.velocity) * static.force, speed <= end)]
    velocity = np.linspace(0.0, end, CURVE_POINTS + 1)[1:]
    x = SPEED._replace(span=(0.0, 1.02 * end * SPEED.unit.factor))
    y = Axis("friction along the motion", NEWTON)
    return plane(title, [*classes, *_curves(found, static, velocity)], x, y, "Both directions on top of each other.", 400)


def static_residuals(found: Identification) -> Panel | LeftOut:
    """Draw the residual of the static fit against speed."""
    title, static = "Residual of the static fit", found.static
    if static is None:
        return LeftOut(title, _NO_STATIC)
    known = found.rig.plant.viscous_damping
    left = static.force - known * static.velocity - steady_force(static.velocity, static.friction)
    traces: list[Trace] = []
    for shown, mark in _by_way(static, left, np.ones(len(left), dtype=bool)):
        bars = {"type": "data", "array": plot.packed(static.deviation[shown]), "thickness": 0.8, "width": 0}
        traces.append(mark | {"error_y": bars | {"color": mark["marker"]["color"]}})
    span = plot.decades(np.abs(static.velocity) * SPEED.unit.factor)
    usual, ratio = _root_mean_square(left), _root_mean_square(left / static.deviation)
    note = f"Root mean square {number(usual)} N, {number(ratio, 2)} times the noise. Bars: one standard deviation of the noise."
    x = SPEED._replace(span=span, logarithmic=True)
    return plane(title, traces, x, Axis("data less static fit", NEWTON), note, 320)


def _root_mean_square(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def _low_end(friction: StaticFriction, speed: Array) -> float:
    """Return the speed up to which the Stribeck curve has decayed, with some of the data below it [m/s]."""
    slowest, fastest = float(speed.min()), float(speed.max())
    try:
        down = friction.stribeck_velocity * (-math.log(FLAT)) ** (1.0 / friction.stribeck_exponent)
    except (OverflowError, ZeroDivisionError):
        down = math.inf
    return min(max(1.2 * down, 3.0 * slowest), fastest) if math.isfinite(down) else fastest


def hysteresis(found: Identification) -> Panel | LeftOut:
    """Draw the friction without its viscous part against displacement, recorded and fitted."""
    title = "Hysteresis loop"
    small = [i for i, motion in enumerate(found.motions) if motion.small]
    if not small or (found.elements and found.branch is None):
        return LeftOut(title, _no_branch(found))
    traces: list[Trace] = []
    modelled: list[Trace] = []
    for order, i in enumerate(small):
        motion, left = found.motions[i], found.fit.residuals[i]
        last = slice(max(0, len(motion.time) - LOOP_BLOCKS), None)
        friction = motion.force - linear_columns(motion, found.fit.linear_names) @ found.fit.linear
        force = np.where(motion.resolved, friction, np.nan)
        there = motion.position[motion.resolved]
        at = (motion.position - 0.5 * float(there.min() + there.max())) * MILLIMETRE.factor
        color = RECORDING_COLORS[order % len(RECORDING_COLORS)]
        recorded = line(at[last], force[last], f"recorded, {motion.name}", NEWTON, color, width=4.0)
        fitted = line(at[last], (force - left)[last], "fitted", NEWTON, BLACK, width=1.2)
        traces.append(recorded | {"mode": "lines"})
        modelled.append(fitted | {"mode": "lines", "showlegend": order == 0, "legendgroup": "fitted"})
    x = Axis("displacement from the middle", MILLIMETRE)
    return plane(title, [*traces, *modelled], x, plot.FRICTION, "Without viscous friction.", 420)


def branch(found: Identification) -> Panel | LeftOut:
    """Draw the mean branch of the loop with its nodes and the ramps of the fitted elements."""
    title = "Mean branch with nodes"
    mean, nodes = found.branch, found.nodes
    if mean is None or not nodes:
        return LeftOut(title, _no_branch(found))
    way = np.array([node.way for node in nodes])
    force = np.array([node.force for node in nodes])
    stiffness = element_stiffness(found)
    at = np.unique(np.concatenate([[0.0], mean.way, way[np.isfinite(way)]]))
    traces = [line(mean.way * MILLIMETRE.factor, mean.force, f"mean of {mean.branches} branches", NEWTON, plot.GREY, width=4.0)]
    parts = stiffness[:, np.newaxis] * np.minimum(at, way[:, np.newaxis])
    shown = at * MILLIMETRE.factor
    if len(nodes) > 1:
        traces.append(line(shown, parts.sum(axis=0), "all elements", NEWTON, VERMILION, width=1.6, dash="dash"))
    for index, part in enumerate(parts):
        color, dash = plot.ELEMENT_LINES[index % len(plot.ELEMENT_LINES)]
        name = f"element {index + 1}, k = {number(1e-3 * stiffness[index], 4)} N/mm"
        traces.append(line(shown, part, name, NEWTON, color, width=1.4, dash=dash))
    names = [f"N{i}" for i in range(1, len(nodes) + 1)]
    mark = dots(way * MILLIMETRE.factor, force, "nodes", NEWTON, BLACK, size=9, remarks=names)
    traces.append(mark | {"mode": "markers+text", "textposition": "top left"})
    remark = elements_remark(found)
    note = f"{remark[0].upper()}{remark[1:]}."
    return plane(title, traces, Axis("travel since the reversal", MILLIMETRE), Axis("force gained", NEWTON), note, 420)


def element_stiffness(found: Identification) -> Array:
    """Return the stiffness of the element that starts to slip at each node, by (22), shape (nodes,) [N/m]."""
    slope = np.array([node.slope for node in found.nodes])
    stiffness: Array = slope - np.append(slope[1:], 0.0)
    return stiffness


def _no_branch(found: Identification) -> str:
    return "it has too few reversals" if any(motion.small for motion in found.motions) else "no presliding is recorded"


def excerpt(motion: Motion, residual: Array, noise: float) -> Panel | LeftOut:
    """Draw an excerpt of a recording: measured and fitted force, and the residual.

    Args:
        motion: the recording.
        residual: measured less fitted force, NaN for blocks not fitted, shape (n,) [N].
        noise: its standard deviation [N].
    """
    title = f"Joint fit: {motion.name}"
    counted = np.isfinite(residual)
    if not counted.any():
        return LeftOut(title, "none of its blocks counted")
    part = _excerpt(counted)
    time, force, left = motion.time[part] - motion.time[part][0], motion.force[part], residual[part]
    figure = Rows(title, time, Axis("force", NEWTON, share=1.5))
    # Small dots, so that isolated samples do not hide the lines below.
    figure.line(force, "measured", plot.SKY, width=4.0)
    figure.line(force - left, "fitted, where it counts", BLACK, width=1.2, marker={"color": BLACK, "size": 2})
    figure.row(Axis("residual", NEWTON))
    figure.line(left, "measured less fitted", BLUE, width=1.0, marker={"color": BLUE, "size": 2})
    figure.traces += _noise_band(float(time[-1]) or motion.period, noise)
    note = (
        f"Blocks of {as_shown(1e3 * motion.period)} ms; {number(100 * float(np.mean(counted)), 2)} % of them count."
        f" Standard deviation of the residual: {number(noise)} N, of the sensor's noise: {number(motion.force_noise)} N."
    )
    panel = figure.panel(note, 380, over_time=False)
    panel.layout["xaxis"]["title"]["text"] = f"time since {number(float(motion.time[part][0]), 4)} s [{plot.SECOND.symbol}]"
    return panel


def _excerpt(counted: Mask) -> slice:
    """Return the stretch closest to the middle with about as many fitted blocks as any."""
    length = min(EXCERPT, len(counted))
    total = np.concatenate([[0], np.cumsum(counted)])
    inside = total[length:] - total[:-length]
    enough = np.flatnonzero(inside >= min(0.9 * length * float(np.mean(counted)), float(inside.max())))
    start = int(enough[np.argmin(np.abs(enough - 0.5 * (len(counted) - length)))])
    return slice(start, start + length)


def _noise_band(end: float, noise: float) -> list[Trace]:
    if not math.isfinite(noise):
        return []
    ends = np.array([0.0, end])
    name = f"± one standard deviation, {number(noise)} N"
    traces = [
        line(ends, np.full(2, sign * noise), name, NEWTON, VERMILION, row=2, width=1.3, dash="dash") for sign in (1.0, -1.0)
    ]
    return [traces[0] | {"legendgroup": name}, traces[1] | {"legendgroup": name, "showlegend": False}]


def residuals(motion: Motion, residual: Array) -> list[Panel | LeftOut]:
    """Draw the residual of the joint fit over the time of a recording, and against velocity."""
    titles = [f"Residual over time: {motion.name}", f"Residual against velocity: {motion.name}"]
    counted = np.flatnonzero(np.isfinite(residual))
    if not counted.size:
        return [LeftOut(title, "none of its blocks counted") for title in titles]
    stride = -(-counted.size // POINTS)
    kept, note = counted[::stride], "" if stride == 1 else f"One block in {stride}."
    time = Axis("time since start", plot.SECOND, (0.0, float(motion.time[-1]) or 1.0))
    panels: list[Panel | LeftOut] = []
    for title, x, values in zip(titles, (time, VELOCITY), (motion.time, motion.velocity), strict=True):
        mark = dots(values[kept] * x.unit.factor, residual[kept], "measured less fitted", NEWTON, BLUE, size=3)
        mark["marker"] |= {"opacity": 0.5, "line": {"width": 0}}
        panels.append(plane(title, [mark], x, Axis("residual", NEWTON), note, 260, showlegend=False))
    return panels


def convergence(found: Identification) -> Panel | LeftOut:
    """Draw the lowest cost of the static fit's search against its iterations."""
    title = "Convergence of the search"
    if found.static is None:
        return LeftOut(title, _NO_STATIC)
    search = found.static.search
    history = np.asarray(search.history, dtype=float)
    cost = np.where(np.isfinite(history) & (history > 0.0), history, np.nan)
    if not np.isfinite(cost).any():
        return LeftOut(title, "it has no finite cost")
    iteration = np.arange(1.0, len(cost) + 1.0)
    how = "converged" if search.converged else f"not converged: {search.advice}"
    panel = plane(
        title,
        [line(iteration, cost, "lowest cost so far", PURE_NUMBER, BLUE, width=2.0)],
        Axis("iteration", PURE_NUMBER),
        Axis("cost", PURE_NUMBER, plot.decades(cost), logarithmic=True),
        f"Half the sum of squares, in standard deviations; {found.method}, {number(search.evaluations)} evaluations, {how}.",
        300,
        showlegend=False,
    )
    panel.layout["yaxis"]["automargin"] = True
    return panel


_NO_STATIC = "nothing slides steadily, so there is no static fit"
