"""Figures of the reproduction report: each function takes results or runs and returns a panel."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report import plot
from ehls_ros.report.page import LeftOut, Panel, number
from ehls_ros.report.plot import Axis, Trace, Unit
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
SHOWN = ("constant", "sine")
"""References of the cells shown in the figures of the bounds."""


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
        color = COLORS.get(controller, plot.GREY)
        ends = np.stack([ours, theirs, np.full(len(rows), np.nan)], axis=1).ravel()
        joined = plot.line(np.repeat(at, 3), np.where(np.isfinite(ends), ends, np.nan), "", plot.NEWTON, color, width=1.0)
        pairs.append(joined | {"mode": "lines", "showlegend": False, "hoverinfo": "skip", "hovertemplate": None})
        traces.append(plot.dots(at, ours, f"{controller}, ours", plot.NEWTON, color, size=9))
        traces.append(plot.dots(at, theirs, f"{controller}, the paper's", plot.NEWTON, color, size=9, symbol="diamond-open"))
    layout = plot.plane_layout(
        Axis(
            "reference and disturbance",
            plot.PURE_NUMBER,
            (0.5, len(places) + 0.5),
            names=tuple(place_name(*place) for place in places),
        ),
        Axis("largest error", plot.NEWTON, plot.decades(everything), logarithmic=True),
    )
    return Panel("Largest errors, ours and the paper's", [*pairs, *traces], layout, height=380, over_time=False)


def stribeck_curve(friction: FrictionCurves) -> Panel:
    """Draw the steady friction against velocity."""
    velocity = np.asarray(friction.velocity_m_s) * plot.MILLIMETRE_PER_SECOND.factor
    trace = plot.line(velocity, np.asarray(friction.steady_force_n), "steady friction", plot.NEWTON, plot.BLUE, width=2.0)
    layout = plot.plane_layout(Axis("velocity", plot.MILLIMETRE_PER_SECOND), Axis("friction", plot.NEWTON)) | {
        "showlegend": False
    }
    title = "Figure 4 of the paper: Stribeck curve"
    return Panel(title, [trace], layout, "Identified, with its viscous part.", height=340, over_time=False)


def hysteresis_loop(friction: FrictionCurves) -> Panel:
    """Draw the friction of a small motion from rest, with the force of each element."""
    at = np.asarray(friction.displacement_m) * plot.MILLIMETRE.factor
    traces = [plot.line(at, np.asarray(friction.hysteresis_n), "all elements", plot.NEWTON, plot.BLACK, width=2.0)]
    for index, force in enumerate(friction.elements_n):
        color, dash = plot.ELEMENT_LINES[index % len(plot.ELEMENT_LINES)]
        traces.append(plot.line(at, np.asarray(force), f"element {index + 1}", plot.NEWTON, color, dash=dash))
    layout = plot.plane_layout(Axis("displacement", plot.MILLIMETRE), Axis("friction", plot.NEWTON))
    title = "Figure 5 of the paper: hysteresis loop"
    return Panel(title, traces, layout, "From rest, without the viscous part.", height=340, over_time=False)


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
    time = since_start(runs[cells[0]])
    traces: list[Trace] = []
    errors: list[NDArray[np.float64]] = []
    for cell in cells:
        run, color = runs[cell], COLORS.get(cell.controller, plot.GREY)
        at, error = since_start(run), run["force_n"] - run["force_reference_n"]
        errors.append(np.abs(error))
        traces.append(plot.time_line(at, run["force_n"], cell.controller, plot.KILONEWTON, color, width=2.0, buckets=BUCKETS))
        below = plot.time_line(at, error, f"{cell.controller}, error", plot.NEWTON, color, row=2, width=1.2, buckets=BUCKETS)
        traces.append(below | {"showlegend": False})
    reference = runs[cells[0]]["force_reference_n"]
    traces.append(
        plot.time_line(time, reference, "reference", plot.KILONEWTON, plot.BLACK, width=1.1, dash="dash", buckets=BUCKETS)
    )
    largest = np.fmax.reduce(errors) if len({len(error) for error in errors}) == 1 else errors[0]
    span, note = steady_span(largest, 0.0, plot.NEWTON.symbol)
    layout = plot.time_layout(time[-1], [Axis("force", plot.KILONEWTON), Axis("error", plot.NEWTON, span)])
    return Panel(title, traces, layout, note and f"Error: {note[0].lower()}{note[1:]}", height=360)


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
    end = np.array([0.0, time[-1]])
    error, s = np.asarray(row.error_line_n), np.asarray(row.s_line)
    error_bound, s_bound = row.error_bound_n, row.s_bound
    error_label = f"bound (44), {number(error_bound)} {plot.NEWTON.symbol}"
    s_label = f"b/h, {number(s_bound)} {plot.PAPER_PRESSURE_RATE.symbol}"
    traces = [
        plot.line(time, error, "|error|", plot.NEWTON, plot.BLUE),
        plot.line(end, np.full(2, error_bound), error_label, plot.NEWTON, plot.VERMILION, dash="dash"),
        plot.line(time, s, "|s|", plot.PAPER_PRESSURE_RATE, plot.GREEN, row=2),
        plot.line(end, np.full(2, s_bound), s_label, plot.PAPER_PRESSURE_RATE, plot.ORANGE, row=2, dash="dash"),
    ]
    for bound, name, dash in (
        (row.paper_bound_s, "(46) + (45) with s = 0", "dot"),
        (row.convergence_bound_s, "for any disturbance", "dashdot"),
    ):
        if 1e-3 * time[-1] < bound < time[-1]:
            traces.append(plot.time_mark(bound, f"{name}: {number(bound)} {plot.SECOND.symbol}", dash=dash))
    rows = [
        Axis("|error|", plot.NEWTON, plot.decades([*error, error_bound]), logarithmic=True),
        Axis("|s|", plot.PAPER_PRESSURE_RATE, plot.decades([*s, s_bound]), logarithmic=True),
    ]
    title = f"The law in continuous time: {row.reference}, {row.disturbance}"
    return Panel(title, traces, plot.time_layout(time[-1], rows), height=340, over_time=False)


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
    period = np.asarray(results.periods_s) * plot.MICROSECOND.factor
    colors = {"explicit": plot.VERMILION, "implicit": plot.BLUE}
    dashes: dict[str, str] = {}
    lines = [(entry, np.asarray(entry.errors_n)) for entry in results.lines]
    low, high = plot.decades([error for _, errors in lines for error in errors])
    high *= 3.0
    traces: list[Trace] = []
    for entry, errors in lines:
        dash = dashes.setdefault(entry.reference, ("solid", "dash", "dot")[len(dashes) % 3])
        color = colors.get(entry.discretisation, plot.GREY)
        name = f"{entry.discretisation}, {entry.reference}"
        drawn = plot.line(period, np.where(np.isfinite(errors), errors, np.nan), name, plot.NEWTON, color, width=1.8, dash=dash)
        traces.append(drawn | {"mode": "lines+markers", "marker": {"color": color, "size": 5}})
    for order, kind in enumerate(dict.fromkeys(entry.discretisation for entry, _ in lines)):
        lost = np.any([~np.isfinite(errors) for entry, errors in lines if entry.discretisation == kind], axis=0)
        if lost.any():
            height = np.full(int(lost.sum()), high / (1.3 * 1.7**order))
            mark = plot.dots(
                period[lost], height, f"{kind}: force lost", plot.NEWTON, colors.get(kind, plot.GREY), symbol="triangle-up"
            )
            traces.append(mark | {"hovertemplate": "%{x:,.4~g} µs: force lost<extra></extra>"})
    limit = results.explicit_limit_s * plot.MICROSECOND.factor
    ends = np.array([0.7 * period[0], 1.4 * period[-1]])
    traces.append(plot.upright(limit, (low, high), f"2/K = {number(limit)} {plot.MICROSECOND.symbol}", dash="dash"))
    if period_s is not None:
        at = period_s * plot.MICROSECOND.factor
        traces.append(plot.upright(at, (low, high), f"Table 3: {as_set(at)} {plot.MICROSECOND.symbol}", plot.GREY))
    traces.append(plot.line(ends, np.full(2, bound_n), "bound (44)", plot.NEWTON, plot.ORANGE, dash="dashdot"))
    layout = plot.plane_layout(
        Axis("sampling period", plot.MICROSECOND, (float(ends[0]), float(ends[1])), logarithmic=True),
        Axis("largest error", plot.NEWTON, (low, high), logarithmic=True),
    )
    return Panel("Largest error against sampling period", traces, layout, height=400, over_time=False)


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
    remarks = [f"{as_set(g.proportional)} 1/s and {as_set(g.integral)} 1/s²" for g in tried]
    traces: list[Trace] = []
    for which, name, color in ((allowed, "keeps its margins", plot.BLUE), (~allowed, "beyond its margins", plot.VERMILION)):
        texts = [text for text, wanted in zip(remarks, which, strict=True) if wanted]
        if not texts:
            continue
        known = which & np.isfinite(worst)
        known_texts = [text for text, wanted in zip(remarks, known, strict=True) if wanted]
        traces.append(plot.dots(proportional[known], worst[known], name, plot.NEWTON, color, remarks=known_texts))
        below = plot.dots(proportional[which], margin[which], name, DEGREE, color, row=2, remarks=texts)
        traces.append(below | {"showlegend": False})
    lost = ~np.isfinite(worst)
    if lost.any():
        height = np.full(int(lost.sum()), high / 1.15)
        mark = plot.dots(proportional[lost], height, "a cell is lost", plot.NEWTON, plot.BLACK, symbol="triangle-up")
        traces.append(mark | {"hovertemplate": "%{x:,.4~g} 1/s: force lost<extra></extra>"})
    for chosen, name, symbol in (
        (found.sic_best, "best with margins", "diamond-open"),
        (found.sic_best_without_margins, "best without", "square-open"),
    ):
        at, error = np.array([chosen.proportional]), np.array([chosen.worst_n])
        label = f"{name}, {error_text(chosen.worst_n)}"
        ring = plot.dots(at, error, label, plot.NEWTON, plot.BLACK, symbol=symbol, size=14)
        traces.append(ring | {"hoverinfo": "skip", "hovertemplate": None})
    if allowed.any():
        last = float(proportional[allowed].max())
        label = f"margins end, {as_set(last)} {PER_SECOND.symbol}"
        traces.append(plot.upright(last, (low, high), label, plot.GREY, dash="dash"))
    if used is not None and used != found.sic_best.proportional:
        traces.append(plot.upright(used, (low, high), "Table 3", plot.GREY))
    layout = plot.stacked_layout(
        Axis("proportional gain", PER_SECOND, (0.8 * proportional.min(), 1.25 * proportional.max()), logarithmic=True),
        [Axis("worst error", plot.NEWTON, (low, high), share=2.0, logarithmic=True), Axis("phase margin", DEGREE)],
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
    width = np.array([entry.smoothing_m_s for entry in tried]) * plot.MILLIMETRE_PER_SECOND.factor
    errors = np.array([np.asarray(entry.errors_n) for entry in tried])
    worst = np.asarray([entry.worst_n for entry in tried])
    low, high = plot.decades([*errors.ravel(), *worst])
    ends = np.array([0.7 * width.min(), 1.4 * width.max()])
    traces: list[Trace] = []
    references = list(dict.fromkeys(reference for reference, _ in found.cells))
    for (reference, disturbance), values in zip(found.cells, errors.T, strict=True):
        color = REFERENCE_COLORS[references.index(reference) % len(REFERENCE_COLORS)]
        dash = "solid" if disturbance == "fd1" else "dash"
        shown = np.where(np.isfinite(values), values, np.nan)
        traces.append(plot.line(width, shown, place_name(reference, disturbance), plot.NEWTON, color, width=1.3, dash=dash))
    drawn = plot.line(width, np.where(np.isfinite(worst), worst, np.nan), "worst", plot.NEWTON, plot.BLACK, width=2.6)
    traces.append(drawn | {"mode": "lines+markers"})
    if gms_worst_n is not None:
        traces.append(
            plot.line(ends, np.full(2, gms_worst_n), "FASMC II, worst", plot.NEWTON, plot.BLUE, width=2.0, dash="dashdot")
        )
    for chosen, name, dash in ((found.stribeck_best, "best width", "dash"), (found.stribeck_natural, "natural width", "dot")):
        at = chosen.smoothing_m_s * plot.MILLIMETRE_PER_SECOND.factor
        traces.append(
            plot.upright(at, (low, high), f"{name}, {as_set(at)} {plot.MILLIMETRE_PER_SECOND.symbol}", plot.GREY, dash=dash)
        )
    layout = plot.plane_layout(
        Axis("smoothing width", plot.MILLIMETRE_PER_SECOND, (float(ends[0]), float(ends[1])), logarithmic=True),
        Axis("largest error", plot.NEWTON, (low, high), logarithmic=True),
    )
    title = "FASMC I against the width of its Stribeck curve"
    return Panel(title, traces, layout, height=440, over_time=False)


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
        label = f"{NOTHING_OFF}, {number(error)} {plot.NEWTON.symbol}"
        traces.append(plot.upright(error, (0.0, len(names) + 1.0), label, plot.GREY, dash="dash"))
    for order, factor in enumerate(factors):
        values = np.array([worst.get((name, factor), np.nan) for name in names])
        color = (plot.SKY, plot.VERMILION, plot.PURPLE, plot.GREEN)[order % 4]
        rows = 1.0 + np.arange(len(names)) + 0.14 * (order - 0.5 * (len(factors) - 1))
        label = f"{as_set(100 * factor)} % of the controller's value"
        known = np.isfinite(values)
        texts = [name for name, shown in zip(names, known, strict=True) if shown]
        mark = plot.dots(values[known], rows[known], label, plot.PURE_NUMBER, color, size=9, remarks=texts)
        traces.append(mark | {"hovertemplate": f"%{{text}}: %{{x:,.4~g}} {plot.NEWTON.symbol}<extra></extra>"})
        if (lost := np.isinf(values)).any():
            at = np.full(int(lost.sum()), 0.98 * edge)
            mark = plot.dots(
                at, rows[lost], f"{as_set(100 * factor)} %: force lost", plot.PURE_NUMBER, color, symbol="triangle-right"
            )
            traces.append(mark | {"hovertemplate": "force lost<extra></extra>"})
    layout = plot.plane_layout(
        Axis("worst error of FASMC II", plot.NEWTON, (0.0, edge)),
        Axis("coefficient", plot.PURE_NUMBER, (0.4, len(names) + 0.6), names=tuple(name.replace("_", " ") for name in names)),
    )
    title = "One coefficient of the rig off"
    height = 160 + 21 * len(names)
    return Panel(title, traces, layout, "Largest error over all cells.", height=height, over_time=False)
