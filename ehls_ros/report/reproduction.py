"""The report of the paper's simulation study: our numbers beside the paper's, and what was asked beyond them."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ehls_ros.report import reproduction_figures as drawn
from ehls_ros.report import reproduction_findings as findings
from ehls_ros.report.figures import setting
from ehls_ros.report.page import (
    Entry,
    LeftOut,
    Panel,
    as_yaml,
    collapsed,
    contents,
    facts,
    figures,
    heading,
    left_out,
    listed,
    number,
    paragraph,
    signed,
    table,
    verdict,
    write_page,
)
from ehls_ros.report.reproduction_findings import FASMC_2, NOTHING_OFF, Key, Results, cell_name
from ehls_ros.trajectory import Trajectory

WORSE = "▲ "
"""Stands before what is worse than the paper's, for those who do not see the colour."""

ADAPTATION_FIGURE = "18"
"""Figure of the paper that shows what is adapted and not the force."""

Runs = Mapping[Key, Trajectory]


def write_reproduction_report(results: Mapping[str, Any], runs: Mapping[Key, Trajectory], path: Path) -> None:
    """Write one HTML file that shows the study and needs nothing else.

    Args:
        results: what ``reproduction.json`` holds. Of its keys only ``cells`` is needed; a part of the page whose keys are
            missing, as after a quick study, is left out.
        runs: the runs of Table 3 by controller, reference and disturbance.
        path: file to write; its folder must exist.
    """
    parts: list[tuple[str, Callable[[Results, Runs], list[str]], tuple[str, ...]]] = [
        ("Table 3", _table3, ("cells",)),
        ("GMS against Stribeck", _reductions, ("reductions",)),
        ("Table 3 as a picture", _dots, ("cells",)),
        ("The paper's figures", _paper_figures, ()),
        ("Theory", _theory, ("theory",)),
        ("Sampling", _sampling, ("sampling",)),
        ("Competitors at their best", _competitors, ("searches",)),
        ("Adaptation", _adaptation, ("drift",)),
        ("Open choices", _choices, ("choices",)),
        ("Robustness", _robustness, ("robustness",)),
        ("How to read it, how it was made", _making, ()),
    ]
    made = [
        (title, blocks)
        for title, make, keys in parts
        if all(results.get(key) for key in keys) and (blocks := [block for block in make(results, runs) if block])
    ]
    sentence, good = findings.verdict_sentence(results)
    write_page(
        path,
        title="The paper's simulation study, run again",
        subtitle="Kang, Yan, Dong, Li: finite-time adaptive sliding mode force control, MSSP 102 (2018) 117–138"
        + (" · quick study" if results.get("quick") else ""),
        blocks=[
            verdict(sentence, good=good),
            contents(title for title, _ in made),
            *(block for title, blocks in made for block in (heading(title), *blocks)),
        ],
    )


def _table3(results: Results, runs: Runs) -> list[str]:
    cells = results["cells"]
    remark = findings.convergence_remark(cells)
    return [
        paragraph(
            "Largest error of the steady half of each run, in N and in % of 10 kN, with the paper's below it."
            f" {WORSE}marks what is worse than the paper's; – where the paper has no number."
        ),
        _by_cell(cells, _error_entry),
        paragraph(f"Convergence time. {remark}"),
        _by_cell(cells, _convergence_entry),
    ]


def _by_cell(cells: Sequence[Mapping[str, Any]], entry: Callable[[Mapping[str, Any]], Entry]) -> str:
    """Make a table with a row a controller and a column for each reference and disturbance."""
    places = list(dict.fromkeys((cell["reference"], cell["disturbance"]) for cell in cells))
    found = {(cell["controller"], cell["reference"], cell["disturbance"]): entry(cell) for cell in cells}
    controllers = dict.fromkeys(cell["controller"] for cell in cells)
    rows = [[controller, *(found.get((controller, *place), "–") for place in places)] for controller in controllers]
    return table(["", *(cell_name(*place) for place in places)], rows)


def _error_entry(cell: Mapping[str, Any]) -> Entry:
    worse = findings.is_above_paper(cell)
    error, theirs = cell["max_error_n"], findings.paper_newton(cell)
    percent = cell["relative_percent"]
    ours = findings.error_text(error)
    if ours != "lost":
        ours += f" · {number(percent)} %"
    paper = f"paper {findings.as_set(theirs)} N · {findings.as_set(cell['paper_percent'])} %" if theirs >= 0 else "paper –"
    return Entry((WORSE if worse else "") + ours, paper, 0.5 if worse else 0.0)


def _convergence_entry(cell: Mapping[str, Any]) -> Entry:
    ours, theirs = cell["convergence_s"], cell["paper_convergence_s"]
    worse = findings.converges_later(cell) is True
    text = f"not reached, ±{number(cell['oscillation_n'])} N" if ours is None else f"{number(ours)} s"
    paper = f"paper {findings.as_set(theirs)} s" if theirs is not None else "paper –"
    return Entry((WORSE if worse else "") + text, paper, 0.5 if worse else 0.0)


def _reductions(results: Results, runs: Runs) -> list[str]:
    found = results.get("searches")
    best, natural = (
        f" ({findings.as_set(1e3 * found[key]['smoothing_m_s'])} mm/s)" if found else ""
        for key in ("stribeck_best", "stribeck_natural")
    )
    rows = []
    for row in results["reductions"]:
        entries = [_reduction_entry(row[key], row) for key in ("best_width_percent", "natural_width_percent")]
        rows.append([row["reference"], *entries, f"{findings.as_set(row['paper_percent'])} %"])
    return [
        paragraph("By how much GMS compensation lowers the largest error against Stribeck compensation, mean of fd1 and fd2."),
        table(["reference", f"ours, best width{best}", f"ours, natural width{natural}", "the paper's"], rows),
        *map(paragraph, findings.cause_remarks(results, runs)),
    ]


def _reduction_entry(percent: float | None, row: Mapping[str, Any]) -> Entry:
    short = findings.is_short(percent, row)
    return Entry(f"{WORSE if short else ''}{number(percent)} %", heat=0.5 if short else 0.0)


def _dots(results: Results, runs: Runs) -> list[str]:
    return [figures([drawn.table_dots(results["cells"])])]


def _paper_figures(results: Results, runs: Runs) -> list[str]:
    planes: list[Panel | LeftOut] = []
    if friction := results.get("friction"):
        planes = [drawn.stribeck_curve(friction), drawn.hysteresis_loop(friction)]
    force: list[Panel | LeftOut] = []
    adapted: list[Panel | LeftOut] = []
    for name, shown in sorted(results.get("figures", {}).items(), key=lambda item: int(item[0])):
        if name == ADAPTATION_FIGURE:
            adapted.append(drawn.paper_adaptation(name, shown, runs))
        else:
            force.append(drawn.paper_figure(name, shown, runs))
    missing = [] if results.get("quick") else [left_out([*force, *adapted])]
    return [figures(planes, columns=2), figures(force, columns=2), figures(adapted), *missing]


def _theory(results: Results, runs: Runs) -> list[str]:
    theory, rows = results["theory"], results.get("continuous", [])
    numbers = [
        ("|s| once reached, b/h", f"{number(theory['s_bound_mpa_s'])} MPa/s"),
        ("What the surface sets against it, k/2", f"{number(theory['slope_mpa_s'])} MPa/s"),
        ("Error once converged (44)", f"{number(theory['error_bound_n'])} N"),
        ("Rate of the robust term, K", f"{number(theory['reaching_rate_1_s'])} 1/s"),
        ("K times the period of Table 3", number(theory["gain_times_period"])),
    ]
    if not rows:
        return [facts(numbers)]
    header = [
        "FASMC II",
        "|s| at the start",
        "|s| ≤ b/h reached",
        "largest |s| after",
        "steady |s|",
        "error at the start",
        "(45), s = 0",
        "(45), largest s",
        "converged to (44)",
        "largest error after",
        "steady error",
        "in time",
    ]
    return [
        *map(paragraph, findings.bounds_remarks(rows)),
        facts(numbers),
        table(header, [_bounds_row(row) for row in rows]),
        figures(drawn.typical_bounds(rows)),
    ]


def _bounds_row(row: Mapping[str, Any]) -> list[str | Entry]:
    late = findings.is_late(row)
    return [
        cell_name(row["reference"], row["disturbance"]),
        f"{number(row['start_s'])} MPa/s",
        Entry(_seconds(row["reached_s"]), f"(46) {_seconds(row['reaching_bound_s'])}"),
        Entry(f"{number(row['largest_s'])} MPa/s", f"b/h {number(row['s_bound'])} MPa/s"),
        f"{number(_steady(row['s_line']))} MPa/s",
        f"{number(row['start_error_n'])} N",
        _seconds(row["sliding_s"]),
        _seconds(row["sliding_bound_s"]),
        Entry(
            f"{WORSE if late else ''}{_seconds(row['converged_s'])}",
            f"paper {_seconds(row['paper_bound_s'])}, kept {_seconds(row['convergence_bound_s'])}",
            0.5 if late else 0.0,
        ),
        Entry(f"{number(row['largest_error_n'])} N", f"(44) {number(row['error_bound_n'])} N"),
        f"{number(_steady(row['error_line_n']))} N",
        Entry("yes") if row["holds"] else Entry(f"{WORSE}no", heat=1.0),
    ]


def _steady(values: Sequence[float | None]) -> float:
    return findings.worst_of(values[len(values) // 2 :])


def _seconds(seconds: float | None) -> str:
    value = findings.error_of(seconds)
    if math.isinf(value):
        return "never"
    return f"{number(1e6 * value)} µs" if 0 < value < 1e-3 else f"{number(value, 4)} s"


def _sampling(results: Results, runs: Runs) -> list[str]:
    theory = results.get("theory", {})
    bound = theory.get("error_bound_n")
    period = findings.period_of(runs)
    return [
        paragraph(findings.sampling_remark(results["sampling"], bound, period)),
        figures([drawn.sampling(results["sampling"], bound, period)]),
    ]


def _competitors(results: Results, runs: Runs) -> list[str]:
    found = results["searches"]
    gains = findings.used_gains(runs)
    worst = findings.worst_of_controller(results, FASMC_2)
    return [
        *map(paragraph, findings.sic_remarks(results, runs)),
        figures([drawn.gains(found, gains and gains[0])]),
        paragraph(findings.stribeck_remark(results)),
        figures([drawn.widths(found, worst)]),
    ]


def _adaptation(results: Results, runs: Runs) -> list[str]:
    drift = results["drift"]
    places = list(dict.fromkeys((row["reference"], row["disturbance"]) for row in drift))
    errors = {(row["adaptation"], row["reference"], row["disturbance"], row["drifts"]): row["max_error_n"] for row in drift}
    rows = [
        [adaptation, *(_drift_entry(errors, adaptation, *place) for place in places)]
        for adaptation in dict.fromkeys(row["adaptation"] for row in drift)
    ]
    return [
        *map(paragraph, findings.adaptation_remarks(drift)),
        paragraph("Largest steady error while the friction drifts as warming oil makes it, with that without drift below it."),
        table(["FASMC II", *(cell_name(*place) for place in places)], rows),
    ]


def _drift_entry(errors: Mapping[Any, float | None], adaptation: str, reference: str, disturbance: str) -> Entry:
    drifts, still = (errors.get((adaptation, reference, disturbance, drifts), math.nan) for drifts in (True, False))
    beyond_reference = findings.error_of(drifts) > findings.FULL_SCALE
    return Entry(_drift_error(drifts), f"no drift {_drift_error(still)}", 0.5 if beyond_reference else 0.0)


def _drift_error(value: float | None) -> str:
    return f"{number(1e-3 * value)} kN" if value is not None and 1e3 <= value < math.inf else findings.error_text(value)


def _choices(results: Results, runs: Runs) -> list[str]:
    cells, choices = results["cells"], results["choices"]
    errors = findings.errors_by_key(cells)
    places = list(dict.fromkeys((cell["reference"], cell["disturbance"]) for cell in cells))
    rows = [
        [
            Entry(f"{choice['what']}: {choice['other']}", f"{choice['controller']}; ours: {choice['ours']}"),
            *(_choice_entry(choice, place, errors) for place in places),
        ]
        for choice in choices
    ]
    return [
        paragraph(
            "What the paper leaves open, set otherwise: change of the largest error against ours; ≈ 0 is less than 0.5 %."
        ),
        *map(paragraph, findings.choices_remarks(choices, cells)),
        table(["choice", *(cell_name(*place) for place in places)], rows),
    ]


def _choice_entry(choice: Mapping[str, Any], place: tuple[str, str], errors: Mapping[Key, float]) -> Entry:
    change = findings.choice_changes(choice, errors).get(cell_name(*place))
    if change is None:
        return Entry("")
    if math.isinf(change):
        return Entry("lost", heat=1.0)
    ours = errors[choice["controller"], *place]
    share = change / ours if ours > 0 else 0.0
    if abs(share) < 5e-3:
        return Entry("≈ 0")
    return Entry(f"{signed(change)} N", f"{signed(100 * share, 2)} %", max(-1.0, min(share, 1.0)))


def _robustness(results: Results, runs: Runs) -> list[str]:
    robustness = results["robustness"]
    draws = robustness["draws"]
    nominal = findings.worst_of_controller(results, FASMC_2)
    errors = findings.errors_by_key(results["cells"])
    columns = [(reference, disturbance) for reference, disturbance in robustness["cells"]]
    rows: list[list[str | Entry]] = [
        [NOTHING_OFF, *(findings.error_text(errors.get((FASMC_2, *column), math.nan)) for column in columns)]
    ]
    for key, label in (("median", "median"), ("p95", "95 %"), ("max", "largest")):
        rows.append([f"{label} of {number(draws['count'])} rigs", *(findings.error_text(value) for value in draws[key])])
    return [
        paragraph(findings.robustness_remark(robustness, nominal)),
        figures([drawn.off_by(robustness, nominal)]),
        paragraph(f"Every coefficient drawn from ±{number(100 * draws['spread'], 2)} % of what the controller believes."),
        table(["largest error of FASMC II", *(cell_name(*column) for column in columns)], rows),
    ]


def _making(results: Results, runs: Runs) -> list[str]:
    run = next(iter(runs.values()), None)
    versions = run.metadata.get("versions", {}) if run is not None else {}
    period = findings.period_of(runs)
    items = [
        ("Runs of Table 3", number(len(results["cells"]))),
        ("Wall time of the study", _with_unit(results.get("wall_s"), "s")),
        ("Compiling", _with_unit(results.get("compile_s"), "s")),
        ("Sampling period", _with_unit(None if period is None else 1e3 * period, "ms")),
        ("Length of a run", _with_unit(float(run.time_s[-1] - run.time_s[0]) if run is not None and len(run) else None, "s")),
        *((str(name), str(version)) for name, version in ({"ehls_ros": results.get("version", "")} | dict(versions)).items()),
    ]
    tuning = {controller: _tuning(found) for (controller, *_), found in runs.items()}
    lost = results.get("diverged_above_n")
    return [
        paragraph(
            "One tuning of each controller serves all references and disturbances. An error is force minus reference, and the"
            " largest error is that of the last half of a run. FASMC I compensates friction by a smoothed Stribeck curve,"
            f" FASMC II by the GMS model; SIC is structure invariance compensation.{_disturbances(runs)}"
            " Sensors are perfect and the controller knows the rig, except where robustness is asked for."
            f" Lost means that the run counted as diverged{f', its largest error {number(lost)} N or more' if lost else ''}."
        ),
        facts([(label, value) for label, value in items if value]),
        collapsed("Tuning", as_yaml(tuning)) if any(tuning.values()) else "",
    ]


def _disturbances(runs: Runs) -> str:
    """Say what fd1 and fd2 are, where the runs tell."""
    told = {}
    for (_, _, name), run in runs.items():
        amplitude, frequency = (
            setting(run.metadata, "spec", "disturbance", "signal", part) for part in ("amplitude", "frequency")
        )
        if amplitude is not None and frequency is not None:
            told[name] = f"{name} is {findings.as_set(1e-3 * amplitude)} kN at {findings.as_set(frequency)} Hz"
    return f" {listed(list(told.values()))}." if told else ""


def _tuning(run: Trajectory) -> dict[str, Any]:
    spec = run.metadata.get("spec", {})
    return {name: spec[name] for name in ("controller", "compensation") if name in spec}


def _with_unit(value: float | None, unit: str) -> str:
    return "" if value is None or not math.isfinite(value) else f"{number(float(np.float64(value)))} {unit}"
