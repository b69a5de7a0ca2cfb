"""Findings on Table 3 of the reproduction: the verdict, convergence, and the gain of GMS compensation.

All sentences are derived from the results. An infinite error belongs to a run that lost the force.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ehls_ros.report.page import limit_text, listed, number
from ehls_ros.reproduction.paper import FASMC_1, FASMC_2, FULL_SCALE, SIC, Cell
from ehls_ros.reproduction.results import CellResult, Place, Reduction, Results, Searches, TriedWidth
from ehls_ros.trajectory import Trajectory

Runs = Mapping[Cell, Trajectory]
"""The runs of Table 3."""

DISTURBANCES = {"fd1": "small", "fd2": "large"}


def place_name(reference: str, disturbance: str) -> str:
    """Return the name of a column of Table 3."""
    return f"{reference} {disturbance}"


def worst_of(errors: Iterable[float]) -> float:
    """Return the largest error [N], infinite if a run lost the force."""
    return float(np.max(np.array(list(errors)), initial=0.0))


def paper_newton(cell: CellResult) -> float:
    """Return the paper's error of a cell [N], NaN if there is none."""
    percent = cell.paper_percent
    return math.nan if percent is None else percent * FULL_SCALE / 100.0


def error_text(error: float) -> str:
    """Write an error [N], or "lost" if the force was lost."""
    return "lost" if math.isinf(error) else f"{number(error)} N"


def as_set(value: float) -> str:
    """Write a chosen number with its given digits."""
    return f"{float(value):,.6g}".replace(",", "\u202f").replace("-", "−")


def errors_by_cell(cells: Sequence[CellResult]) -> dict[Cell, float]:
    """Return the largest error of each cell [N]."""
    return {result.cell: result.max_error_n for result in cells}


def worst_of_controller(results: Results, controller: str) -> float | None:
    """Return a controller's largest error over all cells [N]; None if it has none."""
    errors = [cell.max_error_n for cell in results.cells if cell.controller == controller]
    return max(errors) if errors else None


def is_above_paper(cell: CellResult) -> bool:
    """Return whether the error is larger than the paper's, or the force was lost."""
    theirs = paper_newton(cell)
    return math.isfinite(theirs) and not cell.max_error_n <= theirs


def verdict_sentence(results: Results) -> tuple[str, bool | None]:
    """Summarise the study.

    Args:
        results: the study.

    Returns:
        One sentence that names every shortfall, and whether there is none; None if there is nothing to compare with.
    """
    cells = results.cells
    published = [cell for cell in cells if cell.controller == FASMC_2 and math.isfinite(paper_newton(cell))]
    above = [cell for cell in cells if is_above_paper(cell)]
    within = len(published) - sum(cell.controller == FASMC_2 for cell in above)
    ranked, of = ranking(cells)
    parts = [f"{FASMC_2} is at or below the paper in {within} of {len(published)} cells"] if published else []
    if of:
        parts.append(f"the errors rank {SIC} > {FASMC_1} > {FASMC_2} in {ranked} of {of}")
    if above:
        named = [f"{' '.join(c.cell)} ({_instead(c.max_error_n, paper_newton(c))} N)" for c in above]
        parts.append(f"above the paper: {listed(named)}")
    reductions = results.beyond.reductions if results.beyond is not None else ()
    short = [row for row in reductions if is_short(row.best_width_percent, row)]
    if short:
        named = [f"{row.reference} ({_instead(row.best_width_percent, row.paper_percent)} %)" for row in short]
        parts.append(f"GMS gains less over the best Stribeck curve than in the paper: {listed(named)}")
    draws = None if results.beyond is None else results.beyond.robustness.draws
    lost = 0 if draws is None else draws.diverged
    if draws is not None and lost:
        parts.append(f"{FASMC_2} loses the force on {lost} of {number(draws.count)} rigs that differ from the controller's")
    if not parts:
        return "No cell can be compared with the paper.", None
    return "; ".join(parts) + ".", not above and not short and not lost and ranked == of


def is_short(percent: float, row: Reduction) -> bool:
    """Return whether the reduction is smaller than the paper's; NaN counts as smaller."""
    return not percent >= row.paper_percent


def _instead(ours: float, theirs: float) -> str:
    shown = "lost" if math.isinf(ours) else number(ours)
    return f"{shown} instead of {as_set(theirs) if theirs < 100 else number(theirs)}"


def ranking(cells: Sequence[CellResult]) -> tuple[int, int]:
    """Count the places where the errors rank SIC > FASMC I > FASMC II, and those with all three."""
    errors = errors_by_cell(cells)
    ranks = [[Cell(controller, *place) for controller in (SIC, FASMC_1, FASMC_2)] for place in places_of(cells)]
    known = [[errors[cell] for cell in rank] for rank in ranks if all(cell in errors for cell in rank)]
    return sum(sic > first > second for sic, first, second in known), len(known)


def places_of(cells: Sequence[CellResult]) -> list[Place]:
    """Return the columns of Table 3 in order."""
    return list(dict.fromkeys(Place(cell.reference, cell.disturbance) for cell in cells))


def causal_limits(cells: Sequence[CellResult]) -> list[str]:
    """Return the causal limit in each column of Table 3, the smallest of its controllers' runs, as text."""
    known: dict[Place, list[float]] = {place: [] for place in places_of(cells)}
    for cell in cells:
        if not math.isnan(cell.causal_limit_n):
            known[Place(cell.reference, cell.disturbance)].append(cell.causal_limit_n)
    return [limit_text(min(limits, default=math.nan)) for limits in known.values()]


def converges_later(cell: CellResult) -> bool | None:
    """Return whether an error converged later than in the paper; None if the two times are not comparable.

    They are not comparable if the paper has no time, or if neither error stays within the band: the paper accepts a wider
    oscillation as steady, and its time refers to that.
    """
    ours, theirs = cell.convergence_s, cell.paper_convergence_s
    if theirs is None or (ours is None and paper_newton(cell) > cell.convergence_band_n):
        return None
    return ours is None or ours > theirs


def _cells_listed(cells: Sequence[CellResult]) -> str:
    return listed([" ".join(cell.cell) for cell in cells])


def convergence_remark(cells: Sequence[CellResult]) -> str:
    """Return a remark on the cells in which the error converged no later than in the paper."""
    timed = [cell for cell in cells if cell.paper_convergence_s is not None]
    both = [cell for cell in timed if converges_later(cell) is not None]
    if not timed:
        return ""
    later = [cell for cell in both if converges_later(cell)]
    text = f"No later than in the paper in {len(both) - len(later)} of {len(both)} cells."
    if later:
        text += f" Later: {_cells_listed(later)}."
    if wider := [cell for cell in timed if cell not in both]:
        text += (
            f" Not comparable: {_cells_listed(wider)}, where the paper's error leaves the band used here as well;"
            " its times there refer to a steady oscillation of that size."
        )
    text += (
        " Converged means that the error stays within 1 % of the largest reference, by the middle of the run at the latest; an"
        " error that keeps oscillating beyond this band never converges. A reference that starts at the rig's initial force can"
        " be met from the start, 0 s; the paper has 1.8 s and more."
    )
    if any(cell.cell == Cell(SIC, "sine", "fd2") for cell in timed):
        text += " For SIC, sine, fd2 the paper states more than 6 s."
    return text


def period_of(runs: Runs) -> float | None:
    """Return the sampling period of the runs [s]; None if there is none."""
    for run in runs.values():
        if len(run) > 1:
            return float(np.median(np.diff(run.time_s)))
    return None


def cause_remarks(results: Results, runs: Runs) -> list[str]:
    """Return remarks on the limits to the gain of GMS compensation."""
    remarks = []
    period = period_of(runs)
    floors = []
    for disturbance in DISTURBANCES:
        rates = [
            float(np.nanmax(np.abs(run["disturbance_force_rate_n_s"])))
            for (_, _, d), run in runs.items()
            if d == disturbance and "disturbance_force_rate_n_s" in run
        ]
        errors = [e for (c, _, d), e in errors_by_cell(results.cells).items() if c == FASMC_2 and d == disturbance]
        if rates and errors and period is not None:
            floors.append(
                f"{disturbance} changes by up to {number(max(rates) * period)} N in a cycle,"
                f" and the smallest error of {FASMC_2} is {number(min(errors))} N"
            )
    of_period = f" of {as_set(1e3 * period)} ms" if period is not None else ""
    text = f"D̂ compensates most of the error: it adapts to anything slow compared with a cycle{of_period}."
    if floors:
        text += f" The change of the disturbance within a cycle is a floor for every friction model: {'; '.join(floors)}."
    remarks.append(text)
    if results.beyond is not None:
        remarks.append(_harm_remark(results, results.beyond.searches))
    return remarks


def _harm_remark(results: Results, found: Searches) -> str:
    tried = sorted(found.stribeck, key=lambda entry: entry.smoothing_m_s)
    widest = tried[-1].worst_n
    harmful = [entry for entry in tried if entry.worst_n > widest]
    text = (
        f"With a Stribeck curve of {width_text(tried[-1])}, almost no compensation, the worst cell has {error_text(widest)};"
        f" with the best, {width_text(found.stribeck_best)}, {error_text(found.stribeck_best.worst_n)}."
    )
    if harmful:
        text += (
            f" A curve of {width_text(harmful[-1])} or narrower does harm: at a reversal it changes the friction faster than"
            " the plant does."
        )
    gms = errors_by_cell(results.cells)
    gains = [
        (1.0 - gms[cell] / error, place_name(*place))
        for place, error in zip(found.cells, tried[-1].errors_n, strict=True)
        if error > 0 and (cell := Cell(FASMC_2, *place)) in gms and math.isfinite(gms[cell])
    ]
    if gains:
        least, most = min(gains), max(gains)
        text += (
            f" Compared with almost none, GMS compensation reduces the error by {number(100 * least[0], 2)} % ({least[1]}) to"
            f" {number(100 * most[0], 2)} % ({most[1]})."
        )
    return text


def width_text(tried: TriedWidth) -> str:
    """Write the width of a smoothed Stribeck curve."""
    return f"{as_set(1e3 * tried.smoothing_m_s)} mm/s"
