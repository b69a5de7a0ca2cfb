"""Report on the reproduction of the paper's simulation study: results beside the paper's, and further studies."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ehls_ros.report import page
from ehls_ros.report.page import Entry, LeftOut, Panel, Row, listed, number, signed
from ehls_ros.report.run_signals import setting
from ehls_ros.reproduction import report_figures as drawn
from ehls_ros.reproduction import report_findings as findings
from ehls_ros.reproduction import report_remarks as remarks
from ehls_ros.reproduction.paper import FASMC_2, FULL_SCALE, Cell
from ehls_ros.reproduction.report_findings import Runs, place_name
from ehls_ros.reproduction.results import (
    Beyond,
    CellResult,
    ContinuousRun,
    DriftRun,
    Place,
    Reduction,
    Results,
    TriedChoice,
)
from ehls_ros.trajectory import Trajectory

WORSE = "▲ "
"""Mark, in addition to the colour, of results worse than the paper's."""

ADAPTATION_FIGURE = "18"
"""Figure of the paper that shows the adapted quantities instead of the force."""


def write_reproduction_report(results: Results, runs: Runs, path: Path) -> None:
    """Write one self-contained HTML file that shows the study.

    Args:
        results: the results; those beyond Table 3 are missing after a quick study.
        runs: the runs of Table 3; a figure without its run is listed as left out.
        path: file to write; its folder must exist.
    """
    beyond = results.beyond
    studies = (
        ()
        if beyond is None
        else (
            ("Sampling", _sampling(results, beyond, runs)),
            ("Competitors at their best", _competitors(results, beyond, runs)),
            ("Adaptation", _adaptation(beyond.drift)),
            ("Open choices", _choices(results.cells, beyond.choices)),
            ("Robustness", _robustness(results, beyond)),
        )
    )
    parts = [
        ("Table 3", _table3(results.cells)),
        ("GMS against Stribeck", [] if beyond is None else _reductions(results, beyond, runs)),
        ("Table 3 as a figure", [page.figures([drawn.table_dots(results.cells)])]),
        ("The paper's figures", _paper_figures(results, runs)),
        ("Theory", _theory(results)),
        *studies,
        ("How it was made", _making(results, runs)),
    ]
    sentence, good = findings.verdict_sentence(results)
    page.write_page(
        path,
        title="Reproduction of the paper's simulation study",
        subtitle="Kang, Yan, Dong, Li: finite-time adaptive sliding mode force control, MSSP 102 (2018) 117–138"
        + (" · quick study" if results.quick else ""),
        blocks=[page.verdict(sentence, good=good), *page.sections(parts)],
    )


def _table3(cells: Sequence[CellResult]) -> list[str]:
    return [
        page.paragraph(
            "Largest error in the steady half of each run, in N and in % of 10 kN, with the paper's below it."
            f" {WORSE}marks errors larger than the paper's; – where the paper has no number."
            " No controller without foresight can be expected to stay below the causal limit."
        ),
        _by_cell(cells, _error_entry, ["causal limit", *findings.causal_limits(cells)]),
        page.paragraph(f"Convergence time. {findings.convergence_remark(cells)}"),
        _by_cell(cells, _convergence_entry),
    ]


def _by_cell(cells: Sequence[CellResult], entry: Callable[[CellResult], Entry], *more: Row) -> str:
    """Return a table with a row per controller, a column per reference and disturbance, and further rows."""
    places = findings.places_of(cells)
    entries = {cell.cell: entry(cell) for cell in cells}
    controllers = dict.fromkeys(cell.controller for cell in cells)
    rows = [[controller, *(entries.get(Cell(controller, *place), "–") for place in places)] for controller in controllers]
    return page.table(["", *(place_name(*place) for place in places)], [*rows, *more])


def _error_entry(cell: CellResult) -> Entry:
    worse = findings.is_above_paper(cell)
    error, theirs = cell.max_error_n, findings.paper_newton(cell)
    ours = findings.error_text(error)
    if not math.isinf(error):
        ours += f" · {number(cell.relative_percent)} %"
    paper = "paper –"
    if cell.paper_percent is not None:
        paper = f"paper {findings.as_set(theirs)} N · {findings.as_set(cell.paper_percent)} %"
    return Entry((WORSE if worse else "") + ours, paper, 0.5 if worse else 0.0)


def _convergence_entry(cell: CellResult) -> Entry:
    ours, theirs = cell.convergence_s, cell.paper_convergence_s
    worse = findings.converges_later(cell) is True
    text = f"not reached, ±{number(cell.oscillation_n)} N" if ours is None else f"{number(ours)} s"
    paper = f"paper {findings.as_set(theirs)} s" if theirs is not None else "paper –"
    return Entry((WORSE if worse else "") + text, paper, 0.5 if worse else 0.0)


def _reductions(results: Results, beyond: Beyond, runs: Runs) -> list[str]:
    best, natural = (findings.width_text(tried) for tried in (beyond.searches.stribeck_best, beyond.searches.stribeck_natural))
    table = page.table_of(
        beyond.reductions,
        {
            "reference": lambda row: row.reference,
            f"ours, best width ({best})": lambda row: _reduction_entry(row.best_width_percent, row),
            f"ours, natural width ({natural})": lambda row: _reduction_entry(row.natural_width_percent, row),
            "the paper's": lambda row: f"{findings.as_set(row.paper_percent)} %",
        },
    )
    text = "Reduction of the largest error by GMS against Stribeck compensation, mean of fd1 and fd2."
    return [page.paragraph(text), table, *map(page.paragraph, findings.cause_remarks(results, runs))]


def _reduction_entry(percent: float, row: Reduction) -> Entry:
    short = findings.is_short(percent, row)
    return Entry(f"{WORSE if short else ''}{number(percent)} %", heat=0.5 if short else 0.0)


def _paper_figures(results: Results, runs: Runs) -> list[str]:
    planes = [drawn.stribeck_curve(results.friction), drawn.hysteresis_loop(results.friction)]
    force: list[Panel | LeftOut] = []
    adapted: list[Panel | LeftOut] = []
    for name, cells in sorted(results.figures.items(), key=lambda item: int(item[0])):
        if name == ADAPTATION_FIGURE:
            adapted.append(drawn.paper_adaptation(name, cells[0], runs))
        else:
            force.append(drawn.paper_figure(name, cells, runs))
    missing = [] if results.quick else [page.left_out([*force, *adapted])]
    return [page.figures(planes, columns=2), page.figures(force, columns=2), page.figures(adapted), *missing]


def _theory(results: Results) -> list[str]:
    theory = results.theory
    numbers = [
        ("Bound of |s| once reached, b/h", f"{number(theory.s_bound_mpa_s)} MPa/s"),
        ("k/2, for comparison", f"{number(theory.slope_mpa_s)} MPa/s"),
        ("Error once converged (44)", f"{number(theory.error_bound_n)} N"),
        ("Rate of the robust term, K", f"{number(theory.reaching_rate_1_s)} 1/s"),
        ("K times the period of Table 3", number(theory.gain_times_period)),
    ]
    if results.beyond is None:
        return [page.facts(numbers)]
    rows = results.beyond.continuous
    table = page.table_of(
        rows,
        {
            "FASMC II": lambda row: place_name(row.reference, row.disturbance),
            "|s| at the start": lambda row: f"{number(row.start_s)} MPa/s",
            "|s| ≤ b/h reached": lambda row: Entry(_seconds(row.reached_s), f"(46) {_seconds(row.reaching_bound_s)}"),
            "largest |s| after": lambda row: Entry(f"{number(row.largest_s)} MPa/s", f"b/h {number(row.s_bound)} MPa/s"),
            "steady |s|": lambda row: f"{number(_steady(row.s_line))} MPa/s",
            "error at the start": lambda row: f"{number(row.start_error_n)} N",
            "(45), s = 0": lambda row: _seconds(row.sliding_s),
            "(45), largest s": lambda row: _seconds(row.sliding_bound_s),
            "converged to (44)": _converged,
            "largest error after": lambda row: Entry(f"{number(row.largest_error_n)} N", f"(44) {number(row.error_bound_n)} N"),
            "steady error": lambda row: f"{number(_steady(row.error_line_n))} N",
            "in time": lambda row: Entry("yes") if row.holds else Entry(f"{WORSE}no", heat=1.0),
        },
    )
    texts = map(page.paragraph, remarks.bounds_remarks(rows))
    return [*texts, page.facts(numbers), table, page.figures(drawn.typical_bounds(rows))]


def _converged(row: ContinuousRun) -> Entry:
    late = remarks.is_late(row)
    beside = f"paper {_seconds(row.paper_bound_s)}, kept {_seconds(row.convergence_bound_s)}"
    return Entry(f"{WORSE if late else ''}{_seconds(row.converged_s)}", beside, 0.5 if late else 0.0)


def _steady(values: Sequence[float]) -> float:
    return findings.worst_of(values[len(values) // 2 :])


def _seconds(seconds: float) -> str:
    if math.isinf(seconds):
        return "never"
    return f"{number(1e6 * seconds)} µs" if 0 < seconds < 1e-3 else f"{number(seconds, 4)} s"


def _sampling(results: Results, beyond: Beyond, runs: Runs) -> list[str]:
    bound, period = results.theory.error_bound_n, findings.period_of(runs)
    return [
        page.paragraph(remarks.sampling_remark(beyond.sampling, bound, period)),
        page.figures([drawn.sampling(beyond.sampling, bound, period)]),
    ]


def _competitors(results: Results, beyond: Beyond, runs: Runs) -> list[str]:
    used = remarks.used_gains(runs)
    worst = findings.worst_of_controller(results, FASMC_2)
    return [
        *map(page.paragraph, remarks.sic_remarks(results, beyond.searches, runs)),
        page.figures([drawn.gains(beyond.searches, used and used[0])]),
        page.paragraph(remarks.stribeck_remark(results, beyond.searches)),
        page.figures([drawn.widths(beyond.searches, worst)]),
    ]


def _adaptation(drift: Sequence[DriftRun]) -> list[str]:
    places = list(dict.fromkeys(Place(row.reference, row.disturbance) for row in drift))
    errors = {(row.adaptation, Place(row.reference, row.disturbance), row.drifts): row.max_error_n for row in drift}
    rows: list[Row] = [
        [adaptation, *(_drift_entry(errors[adaptation, place, True], errors[adaptation, place, False]) for place in places)]
        for adaptation in dict.fromkeys(row.adaptation for row in drift)
    ]
    return [
        *map(page.paragraph, remarks.adaptation_remarks(drift)),
        page.paragraph("Largest steady error with friction that drifts as in warming oil, and without drift below it."),
        page.table(["FASMC II", *(place_name(*place) for place in places)], rows),
    ]


def _drift_entry(drifting: float, still: float) -> Entry:
    return Entry(_drift_error(drifting), f"no drift {_drift_error(still)}", 0.5 if drifting > FULL_SCALE else 0.0)


def _drift_error(error: float) -> str:
    return f"{number(1e-3 * error)} kN" if 1e3 <= error < math.inf else findings.error_text(error)


def _choices(cells: Sequence[CellResult], choices: Sequence[TriedChoice]) -> list[str]:
    errors = findings.errors_by_cell(cells)
    places = findings.places_of(cells)
    rows: list[Row] = [
        [
            Entry(f"{choice.what}: {choice.other}", f"{choice.controller}; ours: {choice.ours}"),
            *(_choice_entry(choice, place, errors) for place in places),
        ]
        for choice in choices
    ]
    return [
        page.paragraph(
            "Settings the paper leaves open, with other values: change of the largest error; ≈ 0 is less than 0.5 %."
        ),
        *map(page.paragraph, remarks.choices_remarks(choices, cells)),
        page.table(["choice", *(place_name(*place) for place in places)], rows),
    ]


def _choice_entry(choice: TriedChoice, place: Place, errors: Mapping[Cell, float]) -> Entry:
    change = remarks.choice_changes(choice, errors).get(place_name(*place))
    if change is None:
        return Entry("")
    if math.isinf(change):
        return Entry("lost", heat=1.0)
    ours = errors[Cell(choice.controller, *place)]
    share = change / ours if ours > 0 else 0.0
    if abs(share) < 5e-3:
        return Entry("≈ 0")
    return Entry(f"{signed(change)} N", f"{signed(100 * share, 2)} %", max(-1.0, min(share, 1.0)))


def _robustness(results: Results, beyond: Beyond) -> list[str]:
    robustness = beyond.robustness
    draws = robustness.draws
    nominal = findings.worst_of_controller(results, FASMC_2)
    errors = findings.errors_by_cell(results.cells)
    unchanged = (errors.get(Cell(FASMC_2, *place), math.nan) for place in robustness.cells)
    rows: list[Row] = [[remarks.NOTHING_OFF, *map(findings.error_text, unchanged)]]
    for quantiles, label in ((draws.median, "median"), (draws.p95, "95 %"), (draws.max, "largest")):
        rows.append([f"{label} of {number(draws.count)} rigs", *map(findings.error_text, quantiles)])
    return [
        page.paragraph(remarks.robustness_remark(robustness, nominal)),
        page.figures([drawn.off_by(robustness, nominal)]),
        page.paragraph(f"Every coefficient drawn within ±{number(100 * draws.spread, 2)} % of the controller's value."),
        page.table(["largest error of FASMC II", *(place_name(*place) for place in robustness.cells)], rows),
    ]


def _making(results: Results, runs: Runs) -> list[str]:
    run = next(iter(runs.values()), None)
    versions = run.metadata.get("versions", {}) if run is not None else {}
    period = findings.period_of(runs)
    items = [
        ("Runs of Table 3", number(len(results.cells))),
        ("Wall time of the study", f"{number(results.wall_s)} s"),
        ("Compiling", f"{number(results.compile_s)} s"),
        ("Sampling period", "" if period is None else f"{number(1e3 * period)} ms"),
        ("Length of a run", f"{number(float(run.time_s[-1] - run.time_s[0]))} s" if run is not None and len(run) else ""),
        *((str(name), str(version)) for name, version in ({"ehls_ros": results.version} | dict(versions)).items()),
    ]
    tuning = {cell.controller: _tuning(found) for cell, found in runs.items()}
    return [
        page.paragraph(
            "One tuning of each controller serves all references and disturbances. An error is force minus reference; the"
            " largest error is that of the last half of a run. FASMC I compensates friction by a smoothed Stribeck curve,"
            f" FASMC II by the GMS model; SIC is structure invariance compensation.{_disturbances(runs)}"
            " Sensors are perfect and the controller knows the rig, except in the study of robustness."
            f" 'Lost' marks a run that diverged, with an error of {number(results.diverged_above_n)} N or more."
        ),
        page.facts(items),
        page.collapsed("Tuning", page.as_yaml(tuning)) if any(tuning.values()) else "",
    ]


def _disturbances(runs: Runs) -> str:
    """Return a sentence on fd1 and fd2 if they are known from the runs."""
    found = {}
    for cell, run in runs.items():
        amplitude, frequency = (
            setting(run.metadata, "spec", "disturbance", "signal", name) for name in ("amplitude", "frequency")
        )
        if amplitude is not None and frequency is not None:
            force, rate = findings.as_set(1e-3 * amplitude), findings.as_set(frequency)
            found[cell.disturbance] = f"{cell.disturbance} is {force} kN at {rate} Hz"
    return f" {listed(list(found.values()))}." if found else ""


def _tuning(run: Trajectory) -> dict[str, object]:
    spec = run.metadata.get("spec", {})
    return {name: spec[name] for name in ("controller", "compensation") if name in spec}
