"""Remarks on the studies beyond Table 3: theory, sampling, competitors, adaptation, open choices, robustness."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.report.page import listed, number, signed
from ehls_ros.report.run_signals import setting
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.paper import FASMC_1, FASMC_2, SIC, Cell
from ehls_ros.reproduction.report_findings import (
    Runs,
    as_set,
    error_text,
    errors_by_cell,
    paper_newton,
    place_name,
    width_text,
    worst_of,
    worst_of_controller,
)
from ehls_ros.reproduction.results import (
    CellResult,
    ContinuousRun,
    DriftRun,
    Place,
    Results,
    Robustness,
    Sampling,
    Searches,
    TriedChoice,
)

NOTHING_OFF = "nothing off"

WORTH_NAMING = 0.05
"""Relative difference above which an adaptation counts as having an effect."""


class DriftPlace(NamedTuple):
    """A case of the drift study: whether the friction drifts, reference and disturbance."""

    drifts: bool
    reference: str
    disturbance: str


def is_late(row: ContinuousRun) -> bool:
    """Return whether the continuous law converged later than the paper's bound."""
    return row.converged_s > row.paper_bound_s


def bounds_remarks(rows: Sequence[ContinuousRun]) -> list[str]:
    """Return remarks on whether the law in continuous time keeps the bounds (44) to (46)."""
    within = sum(row.holds for row in rows)
    over = [row for row in rows if is_late(row)]
    text = (
        f"With steps small enough to count as continuous, the law reaches |s| ≤ b/h and the bound (44) in time, and stays"
        f" there, in {within} of {len(rows)} cells."
    )
    if over:
        late = [number(1e3 * (row.converged_s - row.paper_bound_s)) for row in over]
        named = [f"{place_name(row.reference, row.disturbance)} by {by} ms" for row, by in zip(over, late, strict=True)]
        text += (
            f" It exceeds the paper's time, (46) and (45) with s = 0, in {len(over)}: {listed(named)}. That time assumes"
            " s = 0, although only |s| ≤ b/h is reached; the last time bound allows for the remaining s."
        )
    else:
        text += " The paper's time, (46) and (45) with s = 0, is kept as well."
    second = (
        "'Reached' and 'converged' are the last moments outside, so the largest values after them lie inside by definition;"
        " the test is on the times. Steady values are those of the last half."
    )
    return [text, second]


def sampling_remark(sampling: Sampling, bound_n: float, period_s: float | None) -> str:
    """Return a remark on the effect of the sampling period on both discretisations."""
    periods = np.asarray(sampling.periods_s)
    by_kind: dict[str, NDArray[np.float64]] = {}
    for entry in sampling.lines:
        errors = np.asarray(entry.errors_n)
        by_kind[entry.discretisation] = np.maximum(by_kind.get(entry.discretisation, 0.0), errors)
    parts = []
    if (explicit := by_kind.get("explicit")) is not None:
        limit = number(1e6 * sampling.explicit_limit_s)
        parts.append(
            f"The law as printed, discretised explicitly, {_last_good(periods, explicit)}; its theoretical limit is 2/K ="
            f" {limit} µs."
        )
        if period_s is not None and period_s > sampling.explicit_limit_s:
            parts[-1] += f" Table 3 samples {number(period_s / sampling.explicit_limit_s, 2)} times more slowly."
    if (implicit := by_kind.get("implicit")) is not None:
        text = f"Discretised implicitly, it {_last_good(periods, implicit)}"
        if period_s is not None and (near := np.flatnonzero(np.isclose(periods, period_s))).size:
            text += f", with {error_text(float(implicit[near[0]]))} at the {_period(period_s)} of Table 3"
        text += ", and its error grows with the period."
        if (inside := periods[implicit <= bound_n]).size:
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


def sic_remarks(results: Results, found: Searches, runs: Runs) -> list[str]:
    """Return remarks on the best structure invariance compensation, within its margins and beyond."""
    best, beyond = found.sic_best, found.sic_best_without_margins
    allowed = [gain for gain in found.sic if gain.admissible]
    phase = number(min(gain.phase_margin_deg for gain in allowed))
    gain_db = number(min(gain.gain_margin_db for gain in allowed))
    text = (
        f"With the margins a rig needs, SIC is best at {_gains(best.proportional, best.integral)}: {error_text(best.worst_n)}"
        f" in its worst cell. Every loop considered has at least {phase}° and {gain_db} dB."
    )
    used = used_gains(runs)
    worst = worst_of_controller(results, SIC)
    if used is not None and used != (best.proportional, best.integral):
        text += f" Table 3 has {_gains(*used)}{'' if worst is None else f' and {error_text(worst)}'}."
    gms = errors_by_cell(results.cells)
    pairs = [
        (error, gms[Cell(FASMC_2, *place)])
        for place, error in zip(found.cells, beyond.errors_n, strict=True)
        if Cell(FASMC_2, *place) in gms
    ]
    below = sum(error < other for error, other in pairs)
    phase = number(beyond.phase_margin_deg).replace("-", "−")
    unstable = ", so its linear model is unstable" if beyond.phase_margin_deg < 0 else ""
    second = (
        f"Beyond the margins, at {_gains(beyond.proportional, beyond.integral)}, SIC with perfect sensors reaches"
        f" {error_text(beyond.worst_n)} in its worst cell and is below {FASMC_2} in {below} of {len(pairs)} cells."
        f" Its phase margin there is {phase}°{unstable}; no rig should run so."
    )
    return [text, second]


def used_gains(runs: Runs) -> tuple[float, float] | None:
    """Return proportional [1/s] and integral gain [1/s²] of SIC in Table 3; None if unknown."""
    for (controller, *_), run in runs.items():
        if controller == SIC:
            gains = [setting(run.metadata, "spec", "controller", name) for name in ("proportional", "integral")]
            return (gains[0], gains[1]) if gains[0] is not None and gains[1] is not None else None
    return None


def _gains(proportional: float, integral: float) -> str:
    return f"{as_set(proportional)} 1/s and {as_set(integral)} 1/s²"


def stribeck_remark(results: Results, found: Searches) -> str:
    """Return a remark on the best FASMC I in comparison with the paper's numbers."""
    best, natural = found.stribeck_best, found.stribeck_natural
    text = (
        f"FASMC I is best at a width of {width_text(best)}, {error_text(best.worst_n)} in its worst cell; at the natural"
        f" width of {width_text(natural)} it has {error_text(natural.worst_n)}."
    )
    published = {Place(c.reference, c.disturbance): paper_newton(c) for c in results.cells if c.controller == FASMC_1}
    ratios = [
        error / published[place]
        for place, error in zip(found.cells, natural.errors_n, strict=True)
        if math.isfinite(published.get(place, math.nan)) and math.isfinite(error)
    ]
    if ratios:
        text += f" Its errors there are {number(min(ratios), 2)} to {number(max(ratios), 2)} times the paper's FASMC I"
        likely = min(ratios) < 1 < max(ratios)
        text += "; the paper probably compares with such a narrow curve." if likely else "."
    return text


def adaptation_remarks(drift: Sequence[DriftRun]) -> list[str]:
    """Return remarks on the benefit of adapting the friction's scales in addition to D̂."""
    errors: dict[str, dict[DriftPlace, float]] = {}
    for row in drift:
        place = DriftPlace(row.drifts, row.reference, row.disturbance)
        errors.setdefault(row.adaptation, {})[place] = row.max_error_n
    alone = errors.get(paper.DELTA_ALONE, {})
    remarks = []
    if change := _largest_change(errors.get(paper.EVERYTHING, {}), alone):
        share, place = change
        ours, without = errors[paper.EVERYTHING][place], alone[place]
        say = "have no effect here" if share < WORTH_NAMING else "have an effect"
        text = (
            f"α̂ and β̂ {say}: they change the largest error by up to {number(100 * share, 2)} %"
            f" ({_drift_name(place)}: {number(ours)} N with them, {number(without)} N with D̂ alone)."
        )
        if faster := _largest_change(errors.get(paper.TENFOLD, {}), alone):
            text += f" Ten times faster, they change it by {number(100 * faster[0], 2)} % ({_drift_name(faster[1])})."
        remarks.append(text)
    if growth := _growth(errors.get(paper.EVERYTHING, {})):
        text = f"With drifting friction the largest error is up to {number(growth)} times that without drift"
        without_scales = _growth(alone)
        text += f", and up to {number(without_scales)} times with D̂ alone." if without_scales else "."
        remarks.append(text)
    lost = [error for name in (paper.SCALES_ALONE, paper.NO_ADAPTATION) for error in errors.get(name, {}).values()]
    if lost:
        held = max([*errors.get(paper.EVERYTHING, {}).values(), *alone.values()], default=math.nan)
        if math.isinf(min(lost)) or not min(lost) <= 10.0 * held:
            shown = f"at least {number(1e-3 * min(lost))} kN" if math.isfinite(min(lost)) else "unlimited"
            remarks.append(f"Without D̂ the sampled law loses the force: the largest error is {shown}.")
        else:
            remarks.append(f"Without D̂ the largest error is {error_text(min(lost))} to {error_text(max(lost))}.")
    return remarks


def _largest_change(ours: Mapping[DriftPlace, float], base: Mapping[DriftPlace, float]) -> tuple[float, DriftPlace] | None:
    changes = [
        (abs(ours[place] - base[place]) / base[place], index, place)
        for index, place in enumerate(base)
        if place in ours and math.isfinite(ours[place]) and math.isfinite(base[place]) and base[place] > 0
    ]
    if not changes:
        return None
    share, _, place = max(changes)
    return share, place


def _growth(errors: Mapping[DriftPlace, float]) -> float | None:
    ratios = [
        errors[drifting] / still
        for place, still in errors.items()
        if not place.drifts and (drifting := place._replace(drifts=True)) in errors and 0 < still < math.inf
    ]
    return max(ratios) if ratios and math.isfinite(max(ratios)) else None


def _drift_name(place: DriftPlace) -> str:
    return f"{place_name(place.reference, place.disturbance)}, {'with' if place.drifts else 'without'} drift"


def choice_changes(choice: TriedChoice, errors: Mapping[Cell, float]) -> dict[str, float]:
    """Return the change of the largest error by a choice in each place [N], infinite if the force is lost."""
    ours = {place_name(c.reference, c.disturbance): error for c, error in errors.items() if c.controller == choice.controller}
    return {name: error - ours[name] for name, error in choice.errors_n.items() if name in ours}


def choices_remarks(choices: Sequence[TriedChoice], cells: Sequence[CellResult]) -> list[str]:
    """Return a remark on the choice that affects each controller most."""
    errors = errors_by_cell(cells)
    remarks = []
    for controller in dict.fromkeys(choice.controller for choice in choices):
        finite: list[tuple[float, float, str]] = []
        shares: list[tuple[float, float, str]] = []
        lost = []
        for choice in choices:
            if choice.controller != controller:
                continue
            changes = choice_changes(choice, errors)
            label = f"{choice.what}, {choice.other} instead of {choice.ours}"
            count = sum(math.isinf(change) for change in changes.values())
            if count:
                lost.append(f"{label} in {count} of {len(changes)} cells")
            known = [(name, change) for name, change in changes.items() if math.isfinite(change)]
            finite += [(abs(change), change, f"{name}: {label}") for name, change in known]
            parts = [(name, change / (choice.errors_n[name] - change)) for name, change in known if change]
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


def robustness_remark(robustness: Robustness, nominal_n: float | None) -> str:
    """Return a remark on the most harmful coefficient and on the drawn rigs."""
    parameters = robustness.parameters
    worst = [(worst_of(entry.errors_n), -index, entry) for index, entry in enumerate(parameters)]
    parts = []
    if worst:
        error, _, entry = max(worst, key=lambda item: item[:2])
        share = as_set(100 * entry.factor)
        parts.append(f"One at a time, {entry.parameter.replace('_', ' ')} at {share} % does most harm: {error_text(error)}")
        if nominal_n is not None:
            parts[-1] += f" in the worst cell, against {error_text(nominal_n)} with {NOTHING_OFF}"
        parts[-1] += "."
        lost = sum(math.isinf(error) for error, *_ in worst)
        parts.append(f"{lost} of {len(worst)} changes lose the force." if lost else "No change loses the force.")
    draws = robustness.draws
    parts.append(
        f"Of {number(draws.count)} rigs drawn with every coefficient off by up to {number(100 * draws.spread, 2)} %,"
        f" {number(draws.diverged)} lose the force; the worst error of all is {error_text(worst_of(draws.max))}."
    )
    return " ".join(parts)
