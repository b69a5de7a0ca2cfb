"""What the numbers of the reproduction say, in sentences: the verdict and the remarks beside tables and figures.

Everything is worked out from the results, so that a study that comes out otherwise is told otherwise. The keys are those of
``reproduction.json``; an error that is infinite, or null as JSON has it, belongs to a run that lost the force.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report.figures import setting
from ehls_ros.report.page import listed, number, signed
from ehls_ros.trajectory import Trajectory

Results = Mapping[str, Any]
Key = tuple[str, str, str]
"""Controller, reference and disturbance, as Table 3 names them."""
Place = tuple[bool, str, str]
"""Whether the friction drifts, reference and disturbance."""

SIC, FASMC_1, FASMC_2 = "SIC", "FASMC I", "FASMC II"
DISTURBANCES = {"fd1": "small", "fd2": "large"}
NOTHING_OFF = "nothing off"

FULL_SCALE = 1e4
"""Force the paper's relative errors are parts of [N]."""

EVERYTHING, TENFOLD, DELTA_ALONE = "α̂, β̂ and D̂ adapt", "α̂, β̂ ten times as fast", "D̂ alone adapts"
NO_DELTA = ("α̂ and β̂ alone adapt", "nothing adapts")
"""Variants of the adaptation the sentences are about."""

WORTH_NAMING = 0.05
"""Relative difference from which on an adaptation is said to add something."""


def cell_name(reference: str, disturbance: str) -> str:
    """Name a column of Table 3."""
    return f"{reference} {disturbance}"


def error_list(values: Iterable[float | None]) -> NDArray[np.float64]:
    """Give errors as an array [N]; infinite where JSON had to write null."""
    return np.array([error_of(value) for value in values])


def error_of(value: float | None) -> float:
    """Give an error, or a time bound, as a number; infinite where JSON had to write null."""
    return math.inf if value is None else float(value)


def worst_of(values: Iterable[float | None]) -> float:
    """Give the largest error [N], infinite where a run lost the force."""
    return float(np.max(error_list(values), initial=0.0))


def paper_newton(cell: Mapping[str, Any]) -> float:
    """Give the paper's error of a cell [N], NaN where it has none."""
    percent = cell["paper_percent"]
    return math.nan if percent is None else float(percent) * FULL_SCALE / 100.0


def error_text(value: float | None, unit: str = "N", digits: int = 3) -> str:
    """Write an error, or that the force was lost."""
    if value is None or math.isinf(value):
        return "lost"
    return f"{number(value, digits)} {unit}"


def as_set(value: float) -> str:
    """Write a number that was chosen, not measured: no digits it was not given."""
    return f"{float(value):,.6g}".replace(",", "\u202f").replace("-", "−")


def errors_by_key(cells: Sequence[Mapping[str, Any]]) -> dict[Key, float]:
    """Give the largest error [N] by controller, reference and disturbance."""
    return {(c["controller"], c["reference"], c["disturbance"]): error_of(c["max_error_n"]) for c in cells}


def worst_of_controller(results: Results, controller: str) -> float | None:
    """Give a controller's largest error over all cells [N]; None if it has none."""
    errors = [error for (name, *_), error in errors_by_key(results["cells"]).items() if name == controller]
    return max(errors) if errors else None


def is_above_paper(cell: Mapping[str, Any]) -> bool:
    """Tell whether our error is larger than the paper's, or lost."""
    theirs = paper_newton(cell)
    return math.isfinite(theirs) and not error_of(cell["max_error_n"]) <= theirs


def verdict_sentence(results: Results) -> tuple[str, bool | None]:
    """Sum the study up.

    Args:
        results: the study.

    Returns:
        One sentence with every miss in it, and whether there is none; None if there is nothing to judge by.
    """
    cells = results["cells"]
    published = [cell for cell in cells if cell["controller"] == FASMC_2 and math.isfinite(paper_newton(cell))]
    above = [cell for cell in cells if is_above_paper(cell)]
    kept = len(published) - sum(cell["controller"] == FASMC_2 for cell in above)
    ranked, of = ranking(cells)
    parts = [f"{FASMC_2} is at or below the paper in {kept} of {len(published)} cells"] if published else []
    if of:
        parts.append(f"the errors rank {SIC} > {FASMC_1} > {FASMC_2} in {ranked} of {of}")
    if above:
        named = [
            f"{c['controller']} {cell_name(c['reference'], c['disturbance'])} ({_for(c['max_error_n'], paper_newton(c))} N)"
            for c in above
        ]
        parts.append(f"above the paper: {listed(named)}")
    short = [row for row in results.get("reductions", ()) if is_short(row["best_width_percent"], row)]
    if short:
        named = [f"{row['reference']} ({_for(row['best_width_percent'], row['paper_percent'])} %)" for row in short]
        parts.append(f"GMS gains less over the best Stribeck curve than the paper has it: {listed(named)}")
    if not parts:
        return "There is no cell to hold against the paper.", None
    return "; ".join(parts) + ".", not above and not short and ranked == of


def is_short(percent: float | None, row: Mapping[str, Any]) -> bool:
    """Tell whether a reduction of ours is less than the paper's, or none at all."""
    return percent is None or not percent >= row["paper_percent"]


def _for(ours: float | None, theirs: float) -> str:
    shown = "lost" if ours is None or math.isinf(ours) else number(ours)
    return f"{shown} for {as_set(theirs)}" if theirs < 100 else f"{shown} for {number(theirs)}"


def ranking(cells: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """Count in how many combinations SIC is worse than FASMC I and that worse than FASMC II, and of how many."""
    errors = errors_by_key(cells)
    places = [place for place in _places(cells) if all((c, *place) in errors for c in (SIC, FASMC_1, FASMC_2))]
    ranked = sum(errors[SIC, r, d] > errors[FASMC_1, r, d] > errors[FASMC_2, r, d] for r, d in places)
    return ranked, len(places)


def _places(cells: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    return list(dict.fromkeys((cell["reference"], cell["disturbance"]) for cell in cells))


def converges_later(cell: Mapping[str, Any]) -> bool | None:
    """Tell whether an error converged later than in the paper; None where the two times cannot be held against each other.

    That is so where the paper has no time, or where neither error stays within the band: the paper calls a swing steady that
    is wider, and its time is to that.
    """
    ours, theirs = cell["convergence_s"], cell["paper_convergence_s"]
    if theirs is None or (ours is None and paper_newton(cell) > cell["convergence_band_n"]):
        return None
    return ours is None or ours > theirs


def _cells_listed(cells: Sequence[Mapping[str, Any]]) -> str:
    return listed([" ".join((c["controller"], cell_name(c["reference"], c["disturbance"]))) for c in cells])


def convergence_remark(cells: Sequence[Mapping[str, Any]]) -> str:
    """Say in how many cells the error converged no later than in the paper."""
    timed = [cell for cell in cells if cell["paper_convergence_s"] is not None]
    both = [cell for cell in timed if converges_later(cell) is not None]
    if not timed:
        return ""
    later = [cell for cell in both if converges_later(cell)]
    text = f"No later than in the paper in {len(both) - len(later)} of {len(both)} cells."
    if later:
        text += f" Later: {_cells_listed(later)}."
    if wider := [cell for cell in timed if cell not in both]:
        text += (
            f" Not to be compared: {_cells_listed(wider)}, where the paper's error, too, leaves the band that convergence means"
            " here; its times there are until what it calls stable, a swing of its own size."
        )
    text += (
        " Converged means that the error stays within 1 % of the largest reference, from mid-run on at the latest;"
        " the band is the same whatever the error does, so one that keeps swinging beyond it never converges."
        " A reference that starts at the rig's own force can be there from the start, 0 s; the paper has 1.8 s and more."
    )
    if any((c["controller"], c["reference"], c["disturbance"]) == (SIC, "sine", "fd2") for c in timed):
        text += " For SIC, sine, fd2 the paper says more than 6 s."
    return text


def period_of(runs: Mapping[Key, Trajectory]) -> float | None:
    """Give the sampling period of the runs [s]; None if there is none."""
    for run in runs.values():
        if len(run) > 1:
            return float(np.median(np.diff(run.time_s)))
    return None


def cause_remarks(results: Results, runs: Mapping[Key, Trajectory]) -> list[str]:
    """Say why GMS gains what it gains."""
    remarks = []
    period = period_of(runs)
    floors = []
    for disturbance in DISTURBANCES:
        rates = [
            float(np.nanmax(np.abs(run["disturbance_force_rate_n_s"])))
            for (_, _, d), run in runs.items()
            if d == disturbance and "disturbance_force_rate_n_s" in run
        ]
        errors = [e for (c, _, d), e in errors_by_key(results["cells"]).items() if c == FASMC_2 and d == disturbance]
        if rates and errors and period is not None:
            floors.append(
                f"at {disturbance} it changes by up to {number(max(rates) * period)} N in a cycle,"
                f" and the smallest error of {FASMC_2} is {number(min(errors))} N"
            )
    of_period = f" of {as_set(1e3 * period)} ms" if period is not None else ""
    text = f"Most is left to D̂, which learns whatever is slow against a cycle{of_period}."
    if floors:
        text += f" What the disturbance does within a cycle is a floor that no friction model touches: {'; '.join(floors)}."
    remarks.append(text)
    if found := results.get("searches"):
        remarks.append(_harm_remark(results, found))
    return remarks


def _harm_remark(results: Results, found: Mapping[str, Any]) -> str:
    tried = sorted(found["stribeck"], key=lambda entry: float(entry["smoothing_m_s"]))
    widest = worst_of([tried[-1]["worst_n"]])
    harmful = [entry for entry in tried if worst_of([entry["worst_n"]]) > widest]
    text = (
        f"A Stribeck curve of {_mm_s(tried[-1])}, next to no compensation, leaves {error_text(widest)} in its worst cell;"
        f" the best, {_mm_s(found['stribeck_best'])}, {error_text(found['stribeck_best']['worst_n'])}."
    )
    if harmful:
        text += (
            f" One of {_mm_s(harmful[-1])} or narrower does harm: it turns the friction round faster at a reversal than the"
            " plant does."
        )
    gms = errors_by_key(results["cells"])
    gains = [
        (1.0 - gms[FASMC_2, reference, disturbance] / error_of(error), cell_name(reference, disturbance))
        for (reference, disturbance), error in zip(found["cells"], tried[-1]["errors_n"], strict=True)
        if error_of(error) > 0 and math.isfinite(gms.get((FASMC_2, reference, disturbance), math.inf))
    ]
    if gains:
        least, most = min(gains), max(gains)
        text += (
            f" Against next to none, GMS lowers the error by {number(100 * least[0], 2)} % ({least[1]}) to"
            f" {number(100 * most[0], 2)} % ({most[1]})."
        )
    return text


def _mm_s(entry: Mapping[str, Any]) -> str:
    return f"{as_set(1e3 * entry['smoothing_m_s'])} mm/s"


def is_late(row: Mapping[str, Any]) -> bool:
    """Tell whether a cell of the continuous law converged after the paper's own time."""
    return error_of(row["converged_s"]) > error_of(row["paper_bound_s"])


def bounds_remarks(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say whether the law in continuous time keeps what (44) to (46) promise."""
    kept = sum(bool(row["holds"]) for row in rows)
    over = [row for row in rows if is_late(row)]
    text = (
        f"Stepped finely enough to count as continuous, the law reaches |s| ≤ b/h and the bound (44) in time, and stays, in"
        f" {kept} of {len(rows)} cells."
    )
    if over:
        late = [number(1e3 * (error_of(row["converged_s"]) - error_of(row["paper_bound_s"]))) for row in over]
        named = [f"{cell_name(row['reference'], row['disturbance'])} by {by} ms" for row, by in zip(over, late, strict=True)]
        text += (
            f" The paper's own time, (46) and (45) with s = 0, is passed in {len(over)}: {listed(named)}. It takes s for zero,"
            " though no more than |s| ≤ b/h is reached; the last time bound allows for the s that may be left."
        )
    else:
        text += " The paper's own time, (46) and (45) with s = 0, is kept as well."
    second = (
        "Reached and converged are the last moments outside, so the largest values after them lie inside by definition;"
        " what is tested is the time. The steady values are those of the last half."
    )
    return [text, second]


def sampling_remark(sampling: Mapping[str, Any], bound_n: float | None, period_s: float | None) -> str:
    """Say what the sampling period does to both discretisations."""
    periods = np.asarray(sampling["periods_s"])
    by_kind: dict[str, NDArray[np.float64]] = {}
    for entry in sampling["lines"]:
        errors = error_list(entry["errors_n"])
        by_kind[entry["discretisation"]] = np.maximum(by_kind.get(entry["discretisation"], 0.0), errors)
    parts = []
    if (explicit := by_kind.get("explicit")) is not None:
        limit = number(1e6 * sampling["explicit_limit_s"])
        parts.append(
            f"The law as printed, stepped explicitly, {_last_good(periods, explicit)}; in theory its limit is 2/K = {limit} µs."
        )
        if period_s is not None and period_s > sampling["explicit_limit_s"]:
            parts[-1] += f" Table 3 samples {number(period_s / sampling['explicit_limit_s'], 2)} times as slowly."
    if (implicit := by_kind.get("implicit")) is not None:
        text = f"Stepped implicitly it {_last_good(periods, implicit)}"
        if period_s is not None and (near := np.flatnonzero(np.isclose(periods, period_s))).size:
            text += f", with {error_text(float(implicit[near[0]]))} at the {_period(period_s)} of Table 3"
        text += ", and its error grows with the period."
        if bound_n is not None and (inside := periods[implicit <= bound_n]).size:
            text += f" It is inside the bound (44) up to {_period(float(inside.max()))}."
        parts.append(text)
    return " ".join(parts)


def _last_good(periods: NDArray[np.float64], errors: NDArray[np.float64]) -> str:
    lost = periods[~np.isfinite(errors)]
    if not lost.size:
        return f"holds the force at every period up to {_period(float(periods.max()))}"
    good = periods[periods < lost.min()]
    if not good.size:
        return f"loses the force at every period from {_period(float(lost.min()))}"
    return f"holds the force up to {_period(float(good.max()))} and has lost it at {_period(float(lost.min()))}"


def _period(seconds: float) -> str:
    return f"{as_set(1e3 * seconds)} ms" if seconds >= 1e-3 else f"{as_set(1e6 * seconds)} µs"


def sic_remarks(results: Results, runs: Mapping[Key, Trajectory]) -> list[str]:
    """Say how good structure invariance compensation gets, within its margins and beyond."""
    found = results["searches"]
    best, beyond = found["sic_best"], found["sic_best_without_margins"]
    allowed = [gain for gain in found["sic"] if gain["admissible"]]
    least = [number(min(float(gain[name]) for gain in allowed)) for name in ("phase_margin_deg", "gain_margin_db")]
    text = (
        f"With the margins a rig needs, SIC is best at {_gains(best)}: {error_text(best['worst_n'])} in its worst cell."
        f" Every loop counted in has at least {least[0]}° and {least[1]} dB."
    )
    used = used_gains(runs)
    worst = worst_of_controller(results, SIC)
    if used is not None and used != (best["proportional"], best["integral"]):
        chosen = {"proportional": used[0], "integral": used[1]}
        text += f" Table 3 has {_gains(chosen)} and {error_text(worst)}."
    gms = errors_by_key(results["cells"])
    pairs = [
        (error, gms[FASMC_2, reference, disturbance])
        for (reference, disturbance), error in zip(found["cells"], error_list(beyond["errors_n"]), strict=True)
        if (FASMC_2, reference, disturbance) in gms
    ]
    below = sum(error < other for error, other in pairs)
    phase = number(beyond["phase_margin_deg"]).replace("-", "−")
    second = (
        f"Beyond the margins, at {_gains(beyond)}, SIC with perfect sensors reaches {error_text(beyond['worst_n'])} in its"
        f" worst cell and is below {FASMC_2} in {below} of {len(pairs)} cells. The phase margin there is {phase}°"
        f"{', so that its linear model calls it unstable' if beyond['phase_margin_deg'] < 0 else ''}; no rig should be run so."
    )
    return [text, second]


def used_gains(runs: Mapping[Key, Trajectory]) -> tuple[float, float] | None:
    """Give proportional [1/s] and integral gain [1/s²] of SIC in Table 3; None if not told."""
    for (controller, *_), run in runs.items():
        if controller == SIC:
            gains = [setting(run.metadata, "spec", "controller", name) for name in ("proportional", "integral")]
            return (gains[0], gains[1]) if gains[0] is not None and gains[1] is not None else None
    return None


def _gains(gain: Mapping[str, Any]) -> str:
    return f"{as_set(gain['proportional'])} 1/s and {as_set(gain['integral'])} 1/s²"


def stribeck_remark(results: Results) -> str:
    """Say how good FASMC I gets, and where the paper's own numbers lie."""
    found = results["searches"]
    best, natural = found["stribeck_best"], found["stribeck_natural"]
    text = (
        f"FASMC I is best at a width of {_mm_s(best)}, {error_text(best['worst_n'])} in its worst cell; at the natural"
        f" {_mm_s(natural)} it is {error_text(natural['worst_n'])}."
    )
    published = {(c["reference"], c["disturbance"]): paper_newton(c) for c in results["cells"] if c["controller"] == FASMC_1}
    ratios = [
        error / published[reference, disturbance]
        for (reference, disturbance), error in zip(found["cells"], error_list(natural["errors_n"]), strict=True)
        if math.isfinite(published.get((reference, disturbance), math.nan)) and math.isfinite(error)
    ]
    if ratios:
        text += f" There its errors are {number(min(ratios), 2)} to {number(max(ratios), 2)} times the paper's FASMC I"
        likely = min(ratios) < 1 < max(ratios)
        text += "; the paper's comparison is likely one against so narrow a curve." if likely else "."
    return text


def adaptation_remarks(drift: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say whether the adaptation of the friction's scales adds anything to that of D̂."""
    errors: dict[str, dict[Place, float]] = {}
    for row in drift:
        place = bool(row["drifts"]), row["reference"], row["disturbance"]
        errors.setdefault(row["adaptation"], {})[place] = error_of(row["max_error_n"])
    alone = errors.get(DELTA_ALONE, {})
    remarks = []
    if change := _largest_change(errors.get(EVERYTHING, {}), alone):
        share, place = change
        ours, without = errors[EVERYTHING][place], alone[place]
        say = "add nothing here" if share < WORTH_NAMING else "change something"
        text = (
            f"α̂ and β̂ {say}: the largest difference they make to the largest error is {number(100 * share, 2)} %"
            f" ({_drift_name(place)}: {number(ours)} N with them, {number(without)} N with D̂ alone)."
        )
        if faster := _largest_change(errors.get(TENFOLD, {}), alone):
            text += f" Ten times as fast they make {number(100 * faster[0], 2)} % ({_drift_name(faster[1])})."
        remarks.append(text)
    if growth := _growth(errors.get(EVERYTHING, {})):
        text = f"Drifting friction makes the largest error up to {number(growth)} times that without drift"
        without_scales = _growth(alone)
        text += f", and up to {number(without_scales)} times with D̂ alone." if without_scales else "."
        remarks.append(text)
    lost = [error for name in NO_DELTA for error in errors.get(name, {}).values()]
    if lost:
        held = max([*errors.get(EVERYTHING, {}).values(), *alone.values()], default=math.nan)
        if math.isinf(min(lost)) or not min(lost) <= 10.0 * held:
            shown = f"at least {number(1e-3 * min(lost))} kN" if math.isfinite(min(lost)) else "beyond telling"
            remarks.append(f"Without D̂ the sampled law loses the force: the largest error is {shown}.")
        else:
            remarks.append(f"Without D̂ the largest error is {error_text(min(lost))} to {error_text(max(lost))}.")
    return remarks


def _largest_change(ours: Mapping[Place, float], base: Mapping[Place, float]) -> tuple[float, Place] | None:
    changes = [
        (abs(ours[place] - base[place]) / base[place], index, place)
        for index, place in enumerate(base)
        if place in ours and math.isfinite(ours[place]) and math.isfinite(base[place]) and base[place] > 0
    ]
    if not changes:
        return None
    share, _, place = max(changes)
    return share, place


def _growth(errors: Mapping[Place, float]) -> float | None:
    ratios = [
        errors[True, reference, disturbance] / still
        for (drifts, reference, disturbance), still in errors.items()
        if not drifts and (True, reference, disturbance) in errors and 0 < still < math.inf
    ]
    return max(ratios) if ratios and math.isfinite(max(ratios)) else None


def _drift_name(place: Place) -> str:
    drifts, reference, disturbance = place
    return f"{cell_name(reference, disturbance)}, {'with' if drifts else 'without'} drift"


def choice_changes(choice: Mapping[str, Any], errors: Mapping[Key, float]) -> dict[str, float]:
    """Give by how much a choice changes the largest error of each cell it touches [N], infinite where it loses the force."""
    ours = {cell_name(r, d): error for (controller, r, d), error in errors.items() if controller == choice["controller"]}
    return {name: error_of(error) - ours[name] for name, error in choice["errors_n"].items() if name in ours}


def choices_remarks(choices: Sequence[Mapping[str, Any]], cells: Sequence[Mapping[str, Any]]) -> list[str]:
    """Name the choice that moves each controller most."""
    errors = errors_by_key(cells)
    remarks = []
    for controller in dict.fromkeys(choice["controller"] for choice in choices):
        finite: list[tuple[float, float, str]] = []
        shares: list[tuple[float, float, str]] = []
        lost = []
        for choice in choices:
            if choice["controller"] != controller:
                continue
            changes = choice_changes(choice, errors)
            label = f"{choice['what']}, {choice['other']} instead of {choice['ours']}"
            gone = sum(math.isinf(change) for change in changes.values())
            if gone:
                lost.append(f"{label} in {gone} of {len(changes)} cells")
            known = [(name, change) for name, change in changes.items() if math.isfinite(change)]
            finite += [(abs(change), change, f"{name}: {label}") for name, change in known]
            parts = [(name, change / (error_of(choice["errors_n"][name]) - change)) for name, change in known if change]
            shares += [(abs(share), 100 * share, f"{name}: {label}") for name, share in parts]
        text = f"{controller}:"
        if finite:
            _, change, label = max(finite)
            text += f" the largest change is {signed(change)} N ({label})."
        if shares and max(shares)[2] != label:
            text += f" In per cent it is {signed(max(shares)[1])} % ({max(shares)[2]})."
        if lost:
            text += f" The force is lost with {listed(lost)}."
        remarks.append(text)
    return remarks


def robustness_remark(robustness: Mapping[str, Any], nominal_n: float | None) -> str:
    """Name the coefficient that does most harm, and say how the drawn rigs fare."""
    parameters = robustness["parameters"]
    worst = [(worst_of(entry["errors_n"]), -index, entry) for index, entry in enumerate(parameters)]
    parts = []
    if worst:
        error, _, entry = max(worst, key=lambda item: item[:2])
        share = as_set(100 * entry["factor"])
        parts.append(f"One at a time, {entry['parameter'].replace('_', ' ')} at {share} % does most harm: {error_text(error)}")
        if nominal_n is not None:
            parts[-1] += f" in the worst cell, against {error_text(nominal_n)} with nothing off"
        parts[-1] += "."
        gone = sum(math.isinf(error) for error, *_ in worst)
        parts.append(f"{gone} of {len(worst)} changes lose the force." if gone else "No change loses the force.")
    draws = robustness["draws"]
    parts.append(
        f"Of {number(draws['count'])} rigs drawn with every coefficient off by up to {number(100 * draws['spread'], 2)} %,"
        f" {number(draws['diverged'])} lose the force; the worst error of all is {error_text(worst_of(draws['max']))}."
    )
    return " ".join(parts)
