"""The figures of the reproduction report: each function takes plain results or runs and gives a panel."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report import figures
from ehls_ros.report.page import LeftOut, Panel, number
from ehls_ros.report.plot import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    KILONEWTON,
    MICROSECOND,
    MILLIMETRE,
    MILLIMETRE_PER_SECOND,
    NEWTON,
    ORANGE,
    PAPER_PRESSURE_RATE,
    PURE_NUMBER,
    PURPLE,
    SECOND,
    SKY,
    VERMILION,
    Axis,
    Trace,
    Unit,
    decades,
    dots,
    line,
    plane_layout,
    stacked_layout,
    time_layout,
    time_line,
    time_mark,
    upright,
)
from ehls_ros.report.reproduction_findings import (
    DISTURBANCES,
    FASMC_1,
    FASMC_2,
    NOTHING_OFF,
    Key,
    as_set,
    cell_name,
    error_list,
    error_of,
    error_text,
    paper_newton,
    worst_of,
)
from ehls_ros.trajectory import Trajectory

BUCKETS = 1000
"""Parts a line of the paper's many figures is cut into."""

COLORS = {"SIC": GREEN, FASMC_1: VERMILION, FASMC_2: BLUE}
REFERENCE_COLORS = (SKY, ORANGE, GREEN, PURPLE)
PER_SECOND, DEGREE = Unit("1/s"), Unit("°")
SHOWN = ("constant", "sine")
"""References of the cells that stand for all in the figure of the bounds."""


def table_dots(cells: Sequence[Mapping[str, Any]]) -> Panel:
    """Draw Table 3: ours full, the paper's hollow, a controller a colour."""
    keys = list(dict.fromkeys((cell["reference"], cell["disturbance"]) for cell in cells))
    controllers = list(dict.fromkeys(cell["controller"] for cell in cells))
    pairs: list[Trace] = []
    traces: list[Trace] = []
    everything: list[float] = []
    for order, controller in enumerate(controllers):
        rows = [cell for cell in cells if cell["controller"] == controller]
        at = np.array([1.0 + keys.index((row["reference"], row["disturbance"])) for row in rows])
        at += 0.22 * (order - 0.5 * (len(controllers) - 1))
        ours = error_list([row["max_error_n"] for row in rows])
        theirs = np.array([paper_newton(row) for row in rows])
        everything += [*ours, *theirs]
        color = COLORS.get(controller, GREY)
        ends = np.stack([ours, theirs, np.full(len(rows), np.nan)], axis=1).ravel()
        joined = line(np.repeat(at, 3), np.where(np.isfinite(ends), ends, np.nan), "", NEWTON, color, width=1.0)
        pairs.append(joined | {"mode": "lines", "showlegend": False, "hoverinfo": "skip", "hovertemplate": None})
        traces.append(dots(at, ours, f"{controller}, ours", NEWTON, color, size=9))
        traces.append(dots(at, theirs, f"{controller}, the paper's", NEWTON, color, size=9, symbol="diamond-open"))
    layout = plane_layout(
        Axis("reference and disturbance", PURE_NUMBER, (0.5, len(keys) + 0.5), names=tuple(cell_name(*key) for key in keys)),
        Axis("largest error", NEWTON, decades(everything), logarithmic=True),
    )
    return Panel("Largest errors, ours and the paper's", [*pairs, *traces], layout, height=380, over_time=False)


def stribeck_curve(friction: Mapping[str, Any]) -> Panel:
    """Draw the steady friction over velocity."""
    velocity = np.asarray(friction["velocity_m_s"]) * MILLIMETRE_PER_SECOND.factor
    trace = line(velocity, np.asarray(friction["steady_force_n"]), "steady friction", NEWTON, BLUE, width=2.0)
    layout = plane_layout(Axis("velocity", MILLIMETRE_PER_SECOND), Axis("friction", NEWTON)) | {"showlegend": False}
    title = "Figure 4 of the paper: Stribeck curve"
    return Panel(title, [trace], layout, "Identified, with its viscous part.", height=340, over_time=False)


def hysteresis_loop(friction: Mapping[str, Any]) -> Panel:
    """Draw the friction of a small movement from rest, with each element's part."""
    at = np.asarray(friction["displacement_m"]) * MILLIMETRE.factor
    traces = [line(at, np.asarray(friction["hysteresis_n"]), "all elements", NEWTON, BLACK, width=2.0)]
    for index, force in enumerate(friction["elements_n"]):
        color, dash = figures.ELEMENT_LINES[index % len(figures.ELEMENT_LINES)]
        traces.append(line(at, np.asarray(force), f"element {index + 1}", NEWTON, color, dash=dash))
    layout = plane_layout(Axis("displacement", MILLIMETRE), Axis("friction", NEWTON))
    title = "Figure 5 of the paper: hysteresis loop"
    return Panel(title, traces, layout, "From rest, without the viscous part.", height=340, over_time=False)


def paper_figure(figure: str, shown: Sequence[Sequence[str]], runs: Mapping[Key, Trajectory]) -> Panel | LeftOut:
    """Draw the force of one or two controllers with the reference, and the error below.

    Args:
        figure: number of the paper's figure.
        shown: controller, reference and disturbance of each run in it.
        runs: the runs, by the same three words.
    """
    keys = [_key(names) for names in shown]
    title = f"Figure {figure} of the paper: {_caption(keys)}"
    missing = [" ".join(key) for key in keys if key not in runs]
    if missing or not keys:
        return LeftOut(title, f"no run of {', '.join(missing)}" if missing else "it names no run")
    time = figures.since_start(runs[keys[0]])
    traces: list[Trace] = []
    errors: list[NDArray[np.float64]] = []
    for controller, *rest in keys:
        run = runs[controller, rest[0], rest[1]]
        at, color = figures.since_start(run), COLORS.get(controller, GREY)
        error = run["force_n"] - run["force_reference_n"]
        errors.append(np.abs(error))
        traces.append(time_line(at, run["force_n"], controller, KILONEWTON, color, width=2.0, buckets=BUCKETS))
        below = time_line(at, error, f"{controller}, error", NEWTON, color, row=2, width=1.2, buckets=BUCKETS)
        traces.append(below | {"showlegend": False})
    reference = runs[keys[0]]["force_reference_n"]
    traces.append(time_line(time, reference, "reference", KILONEWTON, BLACK, width=1.1, dash="dash", buckets=BUCKETS))
    largest = np.fmax.reduce(errors) if len({len(error) for error in errors}) == 1 else errors[0]
    span, note = figures.steady_span(largest, 0.0, NEWTON.symbol)
    layout = time_layout(time[-1], [Axis("force", KILONEWTON), Axis("error", NEWTON, span)])
    return Panel(title, traces, layout, note and f"Error: {note[0].lower()}{note[1:]}", height=360)


def paper_adaptation(figure: str, shown: Sequence[Sequence[str]], runs: Mapping[Key, Trajectory]) -> Panel | LeftOut:
    """Draw what the controller adapts over a run.

    Args:
        figure: number of the paper's figure.
        shown: controller, reference and disturbance of the run.
        runs: the runs, by the same three words.
    """
    keys = [_key(names) for names in shown]
    title = f"Figure {figure} of the paper: adaptation, {_caption(keys)}"
    if not keys or keys[0] not in runs:
        return LeftOut(title, f"no run of {' '.join(keys[0])}" if keys else "it names no run")
    return replace(figures.adaptation(runs[keys[0]]), title=title)


def _key(names: Sequence[str]) -> Key:
    controller, reference, disturbance = names
    return controller, reference, disturbance


def _caption(keys: Sequence[Key]) -> str:
    controllers = [key[0] for key in keys]
    who = "FASMC" if set(controllers) == {FASMC_1, FASMC_2} else " and ".join(controllers)
    where = {f"{reference} reference, {DISTURBANCES.get(d, d)} disturbance" for _, reference, d in keys}
    return ", ".join([who, *sorted(where)])


def bounds(row: Mapping[str, Any]) -> Panel:
    """Draw error and sliding variable of the continuous law over time, with the bounds of both and of the time.

    Args:
        row: one cell of the study in continuous time.
    """
    time = np.asarray(row["time_s"])
    end = np.array([0.0, time[-1]])
    error, s = error_list(row["error_line_n"]), error_list(row["s_line"])
    error_bound, s_bound = row["error_bound_n"], row["s_bound"]
    error_label = f"bound (44), {number(error_bound)} {NEWTON.symbol}"
    s_label = f"b/h, {number(s_bound)} {PAPER_PRESSURE_RATE.symbol}"
    traces = [
        line(time, error, "|error|", NEWTON, BLUE),
        line(end, np.full(2, error_bound), error_label, NEWTON, VERMILION, dash="dash"),
        line(time, s, "|s|", PAPER_PRESSURE_RATE, GREEN, row=2),
        line(end, np.full(2, s_bound), s_label, PAPER_PRESSURE_RATE, ORANGE, row=2, dash="dash"),
    ]
    for bound, name, dash in (
        (error_of(row["paper_bound_s"]), "(46) + (45) with s = 0", "dot"),
        (error_of(row["convergence_bound_s"]), "kept whatever the disturbance", "dashdot"),
    ):
        if 1e-3 * time[-1] < bound < time[-1]:
            traces.append(time_mark(bound, f"{name}: {number(bound)} {SECOND.symbol}", dash=dash))
    rows = [
        Axis("|error|", NEWTON, decades([*error, error_bound]), logarithmic=True),
        Axis("|s|", PAPER_PRESSURE_RATE, decades([*s, s_bound]), logarithmic=True),
    ]
    title = f"The law in continuous time: {row['reference']}, {row['disturbance']}"
    return Panel(title, traces, time_layout(time[-1], rows), height=340, over_time=False)


def typical_bounds(rows: Sequence[Mapping[str, Any]]) -> list[Panel]:
    """Draw the bounds for the larger disturbance of a reference that starts off and of one that starts on the force."""
    chosen = [row for row in rows if row["disturbance"] == "fd2" and row["reference"] in SHOWN] or list(rows[:2])
    return [bounds(row) for row in chosen]


def sampling(results: Mapping[str, Any], bound_n: float | None, period_s: float | None) -> Panel:
    """Draw the largest error against the sampling period, both discretisations.

    Args:
        results: the study of the period.
        bound_n: the bound (44) [N].
        period_s: period of Table 3 [s].
    """
    period = np.asarray(results["periods_s"]) * MICROSECOND.factor
    colors = {"explicit": VERMILION, "implicit": BLUE}
    dashes: dict[str, str] = {}
    lines = [(entry, error_list(entry["errors_n"])) for entry in results["lines"]]
    low, high = decades([error for _, errors in lines for error in errors])
    high *= 3.0
    traces: list[Trace] = []
    for entry, errors in lines:
        dash = dashes.setdefault(entry["reference"], ("solid", "dash", "dot")[len(dashes) % 3])
        color = colors.get(entry["discretisation"], GREY)
        name = f"{entry['discretisation']}, {entry['reference']}"
        drawn = line(period, np.where(np.isfinite(errors), errors, np.nan), name, NEWTON, color, width=1.8, dash=dash)
        traces.append(drawn | {"mode": "lines+markers", "marker": {"color": color, "size": 5}})
    for order, kind in enumerate(dict.fromkeys(entry["discretisation"] for entry, _ in lines)):
        lost = np.any([~np.isfinite(errors) for entry, errors in lines if entry["discretisation"] == kind], axis=0)
        if lost.any():
            height = np.full(int(lost.sum()), high / (1.3 * 1.7**order))
            mark = dots(period[lost], height, f"{kind}: force lost", NEWTON, colors.get(kind, GREY), symbol="triangle-up")
            traces.append(mark | {"hovertemplate": "%{x:,.4~g} µs: force lost<extra></extra>"})
    limit = results["explicit_limit_s"] * MICROSECOND.factor
    ends = np.array([0.7 * period[0], 1.4 * period[-1]])
    traces.append(upright(limit, (low, high), f"2/K = {number(limit)} {MICROSECOND.symbol}", dash="dash"))
    if period_s is not None:
        at = period_s * MICROSECOND.factor
        traces.append(upright(at, (low, high), f"Table 3: {as_set(at)} {MICROSECOND.symbol}", GREY))
    if bound_n is not None:
        traces.append(line(ends, np.full(2, bound_n), "bound (44)", NEWTON, ORANGE, dash="dashdot"))
    layout = plane_layout(
        Axis("sampling period", MICROSECOND, (float(ends[0]), float(ends[1])), logarithmic=True),
        Axis("largest error", NEWTON, (low, high), logarithmic=True),
    )
    return Panel("Largest error against sampling period", traces, layout, height=400, over_time=False)


def gains(found: Mapping[str, Any], used: float | None) -> Panel:
    """Draw the worst error of structure invariance compensation, and its margin, against its gain.

    Args:
        found: the searches.
        used: proportional gain of Table 3 [1/s].
    """
    tried = found["sic"]
    proportional = np.array([gain["proportional"] for gain in tried])
    worst = error_list([gain["worst_n"] for gain in tried])
    margin = np.array([gain["phase_margin_deg"] for gain in tried], dtype=float)
    allowed = np.array([bool(gain["admissible"]) for gain in tried])
    low, high = decades(worst)
    remarks = [f"{as_set(g['proportional'])} 1/s and {as_set(g['integral'])} 1/s²" for g in tried]
    traces: list[Trace] = []
    for which, name, color in ((allowed, "keeps its margins", BLUE), (~allowed, "beyond its margins", VERMILION)):
        texts = [text for text, wanted in zip(remarks, which, strict=True) if wanted]
        if not texts:
            continue
        known = which & np.isfinite(worst)
        known_texts = [text for text, wanted in zip(remarks, known, strict=True) if wanted]
        traces.append(dots(proportional[known], worst[known], name, NEWTON, color, remarks=known_texts))
        below = dots(proportional[which], margin[which], name, DEGREE, color, row=2, remarks=texts)
        traces.append(below | {"showlegend": False})
    lost = ~np.isfinite(worst)
    if lost.any():
        height = np.full(int(lost.sum()), high / 1.15)
        mark = dots(proportional[lost], height, "a cell is lost", NEWTON, BLACK, symbol="triangle-up")
        traces.append(mark | {"hovertemplate": "%{x:,.4~g} 1/s: force lost<extra></extra>"})
    for key, name, symbol in (
        ("sic_best", "best with margins", "diamond-open"),
        ("sic_best_without_margins", "best without", "square-open"),
    ):
        chosen = found[key]
        at, error = np.array([chosen["proportional"]]), error_list([chosen["worst_n"]])
        label = f"{name}, {error_text(chosen['worst_n'])}"
        ring = dots(at, error, label, NEWTON, BLACK, symbol=symbol, size=14)
        traces.append(ring | {"hoverinfo": "skip", "hovertemplate": None})
    if allowed.any():
        last = float(proportional[allowed].max())
        label = f"margins end, {as_set(last)} {PER_SECOND.symbol}"
        traces.append(upright(last, (low, high), label, GREY, dash="dash"))
    if used is not None and used != found["sic_best"]["proportional"]:
        traces.append(upright(used, (low, high), "Table 3", GREY))
    layout = stacked_layout(
        Axis("proportional gain", PER_SECOND, (0.8 * proportional.min(), 1.25 * proportional.max()), logarithmic=True),
        [Axis("worst error", NEWTON, (low, high), share=2.0, logarithmic=True), Axis("phase margin", DEGREE)],
    )
    note = "Largest error over all cells; a dot for every integral gain tried."
    return Panel("SIC against its gains", traces, layout, note, height=460, over_time=False)


def widths(found: Mapping[str, Any], gms_worst_n: float | None) -> Panel:
    """Draw the errors of FASMC I against the width of the smoothed Stribeck curve.

    Args:
        found: the searches.
        gms_worst_n: worst error of FASMC II [N].
    """
    tried = found["stribeck"]
    width = np.array([entry["smoothing_m_s"] for entry in tried]) * MILLIMETRE_PER_SECOND.factor
    errors = np.array([error_list(entry["errors_n"]) for entry in tried])
    worst = error_list([entry["worst_n"] for entry in tried])
    low, high = decades([*errors.ravel(), *worst])
    ends = np.array([0.7 * width.min(), 1.4 * width.max()])
    traces: list[Trace] = []
    references = list(dict.fromkeys(reference for reference, _ in found["cells"]))
    for (reference, disturbance), values in zip(found["cells"], errors.T, strict=True):
        color = REFERENCE_COLORS[references.index(reference) % len(REFERENCE_COLORS)]
        dash = "solid" if disturbance == "fd1" else "dash"
        shown = np.where(np.isfinite(values), values, np.nan)
        traces.append(line(width, shown, cell_name(reference, disturbance), NEWTON, color, width=1.3, dash=dash))
    drawn = line(width, np.where(np.isfinite(worst), worst, np.nan), "worst", NEWTON, BLACK, width=2.6)
    traces.append(drawn | {"mode": "lines+markers"})
    if gms_worst_n is not None:
        traces.append(line(ends, np.full(2, gms_worst_n), "FASMC II, worst", NEWTON, BLUE, width=2.0, dash="dashdot"))
    for key, name, dash in (("stribeck_best", "best width", "dash"), ("stribeck_natural", "natural width", "dot")):
        at = found[key]["smoothing_m_s"] * MILLIMETRE_PER_SECOND.factor
        traces.append(upright(at, (low, high), f"{name}, {as_set(at)} {MILLIMETRE_PER_SECOND.symbol}", GREY, dash=dash))
    layout = plane_layout(
        Axis("smoothing width", MILLIMETRE_PER_SECOND, (float(ends[0]), float(ends[1])), logarithmic=True),
        Axis("largest error", NEWTON, (low, high), logarithmic=True),
    )
    title = "FASMC I against the width of its Stribeck curve"
    return Panel(title, traces, layout, height=440, over_time=False)


def off_by(robustness: Mapping[str, Any], nominal_n: float | None) -> Panel:
    """Draw the worst error with one coefficient off, a row a coefficient, the most harmful on top.

    Args:
        robustness: the study of the coefficients.
        nominal_n: worst error with none off [N].
    """
    worst = {(entry["parameter"], entry["factor"]): worst_of(entry["errors_n"]) for entry in robustness["parameters"]}
    names = list(dict.fromkeys(name for name, _ in worst))
    factors = sorted({factor for _, factor in worst})
    names.sort(key=lambda name: max(worst[name, factor] for factor in factors if (name, factor) in worst))
    finite = [value for value in worst.values() if np.isfinite(value)]
    nominal = [nominal_n] if nominal_n is not None and np.isfinite(nominal_n) else []
    edge = 1.12 * max([*finite, *nominal], default=1.0)
    traces: list[Trace] = []
    for error in nominal:
        label = f"{NOTHING_OFF}, {number(error)} {NEWTON.symbol}"
        traces.append(upright(error, (0.0, len(names) + 1.0), label, GREY, dash="dash"))
    for order, factor in enumerate(factors):
        values = np.array([worst.get((name, factor), np.nan) for name in names])
        color = (SKY, VERMILION, PURPLE, GREEN)[order % 4]
        rows = 1.0 + np.arange(len(names)) + 0.14 * (order - 0.5 * (len(factors) - 1))
        label = f"{as_set(100 * factor)} % of what the controller believes"
        known = np.isfinite(values)
        texts = [name for name, shown in zip(names, known, strict=True) if shown]
        mark = dots(values[known], rows[known], label, PURE_NUMBER, color, size=9, remarks=texts)
        traces.append(mark | {"hovertemplate": f"%{{text}}: %{{x:,.4~g}} {NEWTON.symbol}<extra></extra>"})
        if (lost := np.isinf(values)).any():
            at = np.full(int(lost.sum()), 0.98 * edge)
            mark = dots(at, rows[lost], f"{as_set(100 * factor)} %: force lost", PURE_NUMBER, color, symbol="triangle-right")
            traces.append(mark | {"hovertemplate": "force lost<extra></extra>"})
    layout = plane_layout(
        Axis("worst error of FASMC II", NEWTON, (0.0, edge)),
        Axis("coefficient", PURE_NUMBER, (0.4, len(names) + 0.6), names=tuple(name.replace("_", " ") for name in names)),
    )
    title = "One coefficient of the rig off"
    height = 110 + 21 * len(names)
    return Panel(title, traces, layout, "Largest error over all cells.", height=height, over_time=False)
