"""Figures of the reproduction report: each function takes results or runs and returns a panel."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report import plot
from ehls_ros.report.page import LeftOut, Panel, Rows, number, plane
from ehls_ros.report.plot import KILONEWTON, MICROSECOND, NEWTON, PURE_NUMBER, Axis, Trace, Unit, dots, line, upright
from ehls_ros.report.run_figures import adaptation, steady_span
from ehls_ros.report.run_signals import since_start
from ehls_ros.reproduction.paper import FASMC_1, FASMC_2, Cell
from ehls_ros.reproduction.report_findings import (
    DISTURBANCES,
    Runs,
    as_set,
    error_text,
    paper_newton,
    place_name,
    places_of,
    worst_of,
)
from ehls_ros.reproduction.report_remarks import NOTHING_OFF
from ehls_ros.reproduction.results import (
    CellResult,
    ContinuousRun,
    FrictionCurves,
    Place,
    Robustness,
    Sampling,
    Searches,
)

BUCKETS = 1000
"""Number of intervals to which a line of the paper's figures is reduced."""

COLORS = {"SIC": plot.GREEN, FASMC_1: plot.VERMILION, FASMC_2: plot.BLUE}
REFERENCE_COLORS = (plot.SKY, plot.ORANGE, plot.GREEN, plot.PURPLE)
PER_SECOND, DEGREE = Unit("1/s"), Unit("°")
RATE = plot.PAPER_PRESSURE_RATE
SHOWN = ("constant", "sine")
"""References of the cells shown in the figures of the bounds."""


def _color(controller: str) -> str:
    return COLORS.get(controller, plot.GREY)


def _lost(
    x: NDArray[np.float64], y: float | NDArray[np.float64], name: str, color: str, where: str, symbol: str = "triangle-up"
) -> Trace:
    """Mark the places at which the force is lost; ``where`` is the text before it under the cursor."""
    mark = dots(x, np.broadcast_to(y, x.shape), name, PURE_NUMBER, color, symbol=symbol)
    return mark | {"hovertemplate": f"{where}force lost<extra></extra>"}


def table_dots(cells: Sequence[CellResult]) -> Panel:
    """Draw Table 3: errors of this study filled, the paper's hollow, one colour per controller."""
    places = places_of(cells)
    controllers = list(dict.fromkeys(cell.controller for cell in cells))
    pairs: list[Trace] = []
    traces: list[Trace] = []
    everything: list[float] = []
    for order, controller in enumerate(controllers):
        rows = [cell for cell in cells if cell.controller == controller]
        at = np.array([1.0 + places.index(Place(row.reference, row.disturbance)) for row in rows])
        at += 0.22 * (order - 0.5 * (len(controllers) - 1))
        ours = np.asarray([row.max_error_n for row in rows])
        theirs = np.array([paper_newton(row) for row in rows])
        everything += [*ours, *theirs]
        color = _color(controller)
        ends = np.stack([ours, theirs, np.full(len(rows), np.nan)], axis=1).ravel()
        joined = line(np.repeat(at, 3), ends, "", NEWTON, color, width=1.0)
        pairs.append(joined | {"mode": "lines"} | plot.SILENT)
        traces.append(dots(at, ours, f"{controller}, ours", NEWTON, color, size=9))
        traces.append(dots(at, theirs, f"{controller}, the paper's", NEWTON, color, size=9, symbol="diamond-open"))
    names = tuple(place_name(*place) for place in places)
    x = Axis("reference and disturbance", PURE_NUMBER, (0.5, len(places) + 0.5), names=names)
    y = Axis("largest error", NEWTON, plot.decades(everything), logarithmic=True)
    return plane("Largest errors, ours and the paper's", [*pairs, *traces], x, y, height=380)


def stribeck_curve(friction: FrictionCurves) -> Panel:
    """Draw the steady friction against velocity."""
    velocity = np.asarray(friction.velocity_m_s) * plot.VELOCITY.unit.factor
    trace = line(velocity, np.asarray(friction.steady_force_n), "steady friction", NEWTON, plot.BLUE, width=2.0)
    title, note = "Figure 4 of the paper: Stribeck curve", "Identified, with its viscous part."
    return plane(title, [trace], plot.VELOCITY, plot.FRICTION, note, showlegend=False)


def hysteresis_loop(friction: FrictionCurves) -> Panel:
    """Draw the friction of a small motion from rest, with the force of each element."""
    x = Axis("displacement", plot.MILLIMETRE)
    at = np.asarray(friction.displacement_m) * x.unit.factor
    traces = [line(at, np.asarray(friction.hysteresis_n), "all elements", NEWTON, plot.BLACK, width=2.0)]
    for index, force in enumerate(friction.elements_n):
        color, dash = plot.ELEMENT_LINES[index % len(plot.ELEMENT_LINES)]
        traces.append(line(at, np.asarray(force), f"element {index + 1}", NEWTON, color, dash=dash))
    title, note = "Figure 5 of the paper: hysteresis loop", "From rest, without the viscous part."
    return plane(title, traces, x, plot.FRICTION, note)


def paper_figure(figure: str, cells: Sequence[Cell], runs: Runs) -> Panel | LeftOut:
    """Draw the force of one or two controllers with the reference, and the error below.

    Args:
        figure: number of the paper's figure.
        cells: the runs in it, at least one.
        runs: the runs of Table 3.
    """
    title = f"Figure {figure} of the paper: {_caption(cells)}"
    if missing := [" ".join(cell) for cell in cells if cell not in runs]:
        return LeftOut(title, f"no run of {', '.join(missing)}")
    first = runs[cells[0]]
    errors = {cell: runs[cell]["force_n"] - runs[cell]["force_reference_n"] for cell in cells}
    largest = np.fmax.reduce([np.abs(error) for error in errors.values() if len(error) == len(first)])
    span, note = steady_span(largest, 0.0, NEWTON.symbol)
    drawn = Rows(title, since_start(first), Axis("force", KILONEWTON), buckets=BUCKETS)
    for cell in cells:
        color, time = _color(cell.controller), since_start(runs[cell])
        drawn.line(runs[cell]["force_n"], cell.controller, color, width=2.0, time=time)
    drawn.line(first["force_reference_n"], "reference", plot.BLACK, width=1.1, dash="dash")
    drawn.row(Axis("error", NEWTON, span))
    for cell, error in errors.items():
        color, time = _color(cell.controller), since_start(runs[cell])
        drawn.line(error, f"{cell.controller}, error", color, width=1.2, time=time, showlegend=False)
    return drawn.panel(note and f"Error: {note[0].lower()}{note[1:]}", 360)


def paper_adaptation(figure: str, cell: Cell, runs: Runs) -> Panel | LeftOut:
    """Draw the adapted quantities over a run.

    Args:
        figure: number of the paper's figure.
        cell: the run in it.
        runs: the runs of Table 3.
    """
    title = f"Figure {figure} of the paper: adaptation, {_caption([cell])}"
    if cell not in runs:
        return LeftOut(title, f"no run of {' '.join(cell)}")
    return replace(adaptation(runs[cell]), title=title)


def _caption(cells: Sequence[Cell]) -> str:
    controllers = [cell.controller for cell in cells]
    who = "FASMC" if set(controllers) == {FASMC_1, FASMC_2} else " and ".join(controllers)
    where = {f"{cell.reference} reference, {DISTURBANCES.get(cell.disturbance)} disturbance" for cell in cells}
    return ", ".join([who, *sorted(where)])


def bounds(row: ContinuousRun) -> Panel:
    """Draw error and sliding variable of the continuous law over time, with the bounds of both and of the time.

    Args:
        row: one cell of the study in continuous time.
    """
    time = np.asarray(row.time_s)
    figure = Rows(f"The law in continuous time: {row.reference}, {row.disturbance}", time, buckets=len(time))
    for name, values, bound, label, unit, colors in (
        ("|error|", row.error_line_n, row.error_bound_n, "bound (44),", NEWTON, (plot.BLUE, plot.VERMILION)),
        ("|s|", row.s_line, row.s_bound, "b/h,", RATE, (plot.GREEN, plot.ORANGE)),
    ):
        figure.row(Axis(name, unit, plot.decades([*values, bound]), logarithmic=True))
        figure.line(np.asarray(values), name, colors[0])
        figure.line(np.full(time.shape, bound), f"{label} {number(bound)} {unit.symbol}", colors[1], dash="dash")
    for bound, name, dash in (
        (row.paper_bound_s, "(46) + (45) with s = 0", "dot"),
        (row.convergence_bound_s, "for any disturbance", "dashdot"),
    ):
        if 1e-3 * time[-1] < bound < time[-1]:
            figure.traces.append(plot.time_mark(bound, f"{name}: {number(bound)} {plot.SECOND.symbol}", dash=dash))
    return figure.panel(height=340, over_time=False)


def typical_bounds(rows: Sequence[ContinuousRun]) -> list[Panel]:
    """Draw the bounds under the larger disturbance, for references that start away from the initial force and at it."""
    chosen = [row for row in rows if row.disturbance == "fd2" and row.reference in SHOWN] or list(rows[:2])
    return [bounds(row) for row in chosen]


def sampling(results: Sampling, bound_n: float, period_s: float | None) -> Panel:
    """Draw the largest error against the sampling period, both discretisations.

    Args:
        results: errors by period.
        bound_n: the bound (44) [N].
        period_s: period of Table 3 [s].
    """
    period = np.asarray(results.periods_s) * MICROSECOND.factor
    colors = {"explicit": plot.VERMILION, "implicit": plot.BLUE}
    dashes: dict[str, str] = {}
    lines = [(entry, np.asarray(entry.errors_n)) for entry in results.lines]
    low, high = plot.decades([error for _, errors in lines for error in errors])
    high *= 3.0
    traces: list[Trace] = []
    for entry, errors in lines:
        dash = dashes.setdefault(entry.reference, ("solid", "dash", "dot")[len(dashes) % 3])
        color = colors.get(entry.discretisation, plot.GREY)
        drawn = line(period, errors, f"{entry.discretisation}, {entry.reference}", NEWTON, color, width=1.8, dash=dash)
        traces.append(drawn | {"mode": "lines+markers", "marker": {"color": color, "size": 5}})
    for order, kind in enumerate(dict.fromkeys(entry.discretisation for entry, _ in lines)):
        lost = np.any([~np.isfinite(errors) for entry, errors in lines if entry.discretisation == kind], axis=0)
        if lost.any():
            height, color = high / (1.3 * 1.7**order), colors.get(kind, plot.GREY)
            traces.append(_lost(period[lost], height, f"{kind}: force lost", color, "%{x:,.4~g} µs: "))
    limit = results.explicit_limit_s * MICROSECOND.factor
    ends = np.array([0.7 * period[0], 1.4 * period[-1]])
    traces.append(upright(limit, (low, high), f"2/K = {number(limit)} {MICROSECOND.symbol}", dash="dash"))
    if period_s is not None:
        at = period_s * MICROSECOND.factor
        traces.append(upright(at, (low, high), f"Table 3: {as_set(at)} {MICROSECOND.symbol}", plot.GREY))
    traces.append(line(ends, np.full(2, bound_n), "bound (44)", NEWTON, plot.ORANGE, dash="dashdot"))
    x = Axis("sampling period", MICROSECOND, (float(ends[0]), float(ends[1])), logarithmic=True)
    y = Axis("largest error", NEWTON, (low, high), logarithmic=True)
    return plane("Largest error against sampling period", traces, x, y, height=400)


def gains(found: Searches, used: float | None) -> Panel:
    """Draw the worst error of structure invariance compensation, and its margin, against its gain.

    Args:
        found: the searches.
        used: proportional gain of Table 3 [1/s].
    """
    tried = found.sic
    proportional = np.array([gain.proportional for gain in tried])
    worst = np.asarray([gain.worst_n for gain in tried])
    margin = np.array([gain.phase_margin_deg for gain in tried])
    allowed = np.array([gain.admissible for gain in tried])
    low, high = plot.decades(worst)
    remarks = np.array([f"{as_set(g.proportional)} 1/s and {as_set(g.integral)} 1/s²" for g in tried])
    traces: list[Trace] = []
    for which, name, color in ((allowed, "keeps its margins", plot.BLUE), (~allowed, "beyond its margins", plot.VERMILION)):
        if which.any():
            texts = remarks[which].tolist()
            traces.append(dots(proportional[which], worst[which], name, NEWTON, color, remarks=texts))
            below = dots(proportional[which], margin[which], name, DEGREE, color, row=2, remarks=texts)
            traces.append(below | {"showlegend": False})
    if (lost := ~np.isfinite(worst)).any():
        traces.append(_lost(proportional[lost], high / 1.15, "a cell is lost", plot.BLACK, "%{x:,.4~g} 1/s: "))
    for chosen, name, symbol in (
        (found.sic_best, "best with margins", "diamond-open"),
        (found.sic_best_without_margins, "best without", "square-open"),
    ):
        at, error = np.array([chosen.proportional]), np.array([chosen.worst_n])
        ring = dots(at, error, f"{name}, {error_text(chosen.worst_n)}", NEWTON, plot.BLACK, symbol=symbol, size=14)
        traces.append(ring | {"hoverinfo": "skip", "hovertemplate": None})
    if allowed.any():
        last = float(proportional[allowed].max())
        label = f"margins end, {as_set(last)} {PER_SECOND.symbol}"
        traces.append(upright(last, (low, high), label, plot.GREY, dash="dash"))
    if used is not None and used != found.sic_best.proportional:
        traces.append(upright(used, (low, high), "Table 3", plot.GREY))
    layout = plot.stacked_layout(
        Axis("proportional gain", PER_SECOND, (0.8 * proportional.min(), 1.25 * proportional.max()), logarithmic=True),
        [Axis("worst error", NEWTON, (low, high), share=2.0, logarithmic=True), Axis("phase margin", DEGREE)],
    )
    note = "Largest error over all cells; one dot per integral gain tried."
    return Panel("SIC against its gains", traces, layout, note, height=460, over_time=False)


def widths(found: Searches, gms_worst_n: float | None) -> Panel:
    """Draw the errors of FASMC I against the width of the smoothed Stribeck curve.

    Args:
        found: the searches.
        gms_worst_n: worst error of FASMC II [N].
    """
    tried = found.stribeck
    unit = plot.MILLIMETRE_PER_SECOND
    width = np.array([entry.smoothing_m_s for entry in tried]) * unit.factor
    errors = np.array([np.asarray(entry.errors_n) for entry in tried])
    worst = np.asarray([entry.worst_n for entry in tried])
    low, high = plot.decades([*errors.ravel(), *worst])
    ends = np.array([0.7 * width.min(), 1.4 * width.max()])
    traces: list[Trace] = []
    references = list(dict.fromkeys(reference for reference, _ in found.cells))
    for (reference, disturbance), values in zip(found.cells, errors.T, strict=True):
        color = REFERENCE_COLORS[references.index(reference) % len(REFERENCE_COLORS)]
        dash = "solid" if disturbance == "fd1" else "dash"
        traces.append(line(width, values, place_name(reference, disturbance), NEWTON, color, width=1.3, dash=dash))
    traces.append(line(width, worst, "worst", NEWTON, plot.BLACK, width=2.6) | {"mode": "lines+markers"})
    if gms_worst_n is not None:
        traces.append(line(ends, np.full(2, gms_worst_n), "FASMC II, worst", NEWTON, plot.BLUE, width=2.0, dash="dashdot"))
    for chosen, name, dash in ((found.stribeck_best, "best width", "dash"), (found.stribeck_natural, "natural width", "dot")):
        at = chosen.smoothing_m_s * unit.factor
        traces.append(upright(at, (low, high), f"{name}, {as_set(at)} {unit.symbol}", plot.GREY, dash=dash))
    x = Axis("smoothing width", unit, (float(ends[0]), float(ends[1])), logarithmic=True)
    y = Axis("largest error", NEWTON, (low, high), logarithmic=True)
    return plane("FASMC I against the width of its Stribeck curve", traces, x, y, height=440)


def off_by(robustness: Robustness, nominal_n: float | None) -> Panel:
    """Draw the worst error with one coefficient off, one row per coefficient, the most harmful on top.

    Args:
        robustness: errors by coefficient.
        nominal_n: worst error with no coefficient off [N].
    """
    worst = {(entry.parameter, entry.factor): worst_of(entry.errors_n) for entry in robustness.parameters}
    names = list(dict.fromkeys(name for name, _ in worst))
    factors = sorted({factor for _, factor in worst})
    names.sort(key=lambda name: max(worst[name, factor] for factor in factors if (name, factor) in worst))
    finite = [value for value in worst.values() if np.isfinite(value)]
    nominal = [nominal_n] if nominal_n is not None and np.isfinite(nominal_n) else []
    edge = 1.12 * max([*finite, *nominal], default=1.0)
    traces: list[Trace] = []
    for error in nominal:
        label = f"{NOTHING_OFF}, {number(error)} {NEWTON.symbol}"
        traces.append(upright(error, (0.0, len(names) + 1.0), label, plot.GREY, dash="dash"))
    for order, factor in enumerate(factors):
        values = np.array([worst.get((name, factor), np.nan) for name in names])
        color = (plot.SKY, plot.VERMILION, plot.PURPLE, plot.GREEN)[order % 4]
        rows = 1.0 + np.arange(len(names)) + 0.14 * (order - 0.5 * (len(factors) - 1))
        label = f"{as_set(100 * factor)} % of the controller's value"
        known = np.isfinite(values)
        texts = [name for name, shown in zip(names, known, strict=True) if shown]
        mark = dots(values[known], rows[known], label, PURE_NUMBER, color, size=9, remarks=texts)
        traces.append(mark | {"hovertemplate": f"%{{text}}: %{{x:,.4~g}} {NEWTON.symbol}<extra></extra>"})
        if (lost := np.isinf(values)).any():
            at, label = np.full(int(lost.sum()), 0.98 * edge), f"{as_set(100 * factor)} %: force lost"
            traces.append(_lost(at, rows[lost], label, color, "", "triangle-right"))
    x = Axis("worst error of FASMC II", NEWTON, (0.0, edge))
    labels = tuple(name.replace("_", " ") for name in names)
    y = Axis("coefficient", PURE_NUMBER, (0.4, len(names) + 0.6), names=labels)
    return plane("One coefficient of the rig off", traces, x, y, "Largest error over all cells.", 160 + 21 * len(names))
