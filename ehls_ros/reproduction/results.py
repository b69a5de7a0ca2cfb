"""``reproduction.json``: results of the study as frozen records, whose field names are the keys.

An error is the largest of the steady half of a run [N], infinite if the run diverged. ``table3.json`` has only the cells.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ehls_ros.experiments.json_document import json_document
from ehls_ros.reproduction.paper import Cell


class CellResult(NamedTuple):
    """One cell of Table 3.

    Attributes:
        controller, reference, disturbance: names of the cell.
        max_error_n, rms_error_n: largest and rms steady error [N].
        relative_percent: largest error in per cent of 10 kN.
        paper_percent: the paper's value; None if it has none.
        convergence_s: convergence time [s]; None if the error does not converge.
        convergence_band_n: half width of the band of a converged error [N].
        oscillation_n: half the distance between smallest and largest steady error [N].
        paper_convergence_s: the paper's convergence time [s]; None if it has none.
        causal_limit_n: causal limit of the largest error [N]; NaN if not determined.
    """

    controller: str
    reference: str
    disturbance: str
    max_error_n: float
    rms_error_n: float
    relative_percent: float
    paper_percent: float | None
    convergence_s: float | None
    convergence_band_n: float
    oscillation_n: float
    paper_convergence_s: float | None
    causal_limit_n: float = math.nan

    @property
    def cell(self) -> Cell:
        """The cell."""
        return Cell(self.controller, self.reference, self.disturbance)


class Place(NamedTuple):
    """A column of Table 3."""

    reference: str
    disturbance: str


class TriedGains(NamedTuple):
    """Structure invariance compensation with one pair of gains.

    Attributes:
        proportional, integral: gains [1/s], [1/s²].
        gain_margin_db, phase_margin_deg: margins of its linear model.
        admissible: whether both margins suffice for a rig.
        errors_n: error in each place.
        worst_n: the largest of them.
    """

    proportional: float
    integral: float
    gain_margin_db: float
    phase_margin_deg: float
    admissible: bool
    errors_n: tuple[float, ...]
    worst_n: float


class TriedWidth(NamedTuple):
    """FASMC I with one width of the smoothed Stribeck curve.

    Attributes:
        smoothing_m_s: the width [m/s].
        errors_n: error in each place.
        worst_n: the largest of them.
    """

    smoothing_m_s: float
    errors_n: tuple[float, ...]
    worst_n: float


class Searches(NamedTuple):
    """The competitors at their best.

    Attributes:
        cells: the places of the errors.
        sic: gains tried.
        sic_best: best gains with sufficient margins.
        sic_best_without_margins: best gains regardless of margins.
        stribeck: widths tried.
        stribeck_best: best width.
        stribeck_natural: width that reproduces the paper's errors.
    """

    cells: tuple[Place, ...]
    sic: tuple[TriedGains, ...]
    sic_best: TriedGains
    sic_best_without_margins: TriedGains
    stribeck: tuple[TriedWidth, ...]
    stribeck_best: TriedWidth
    stribeck_natural: TriedWidth


class Reduction(NamedTuple):
    """Reduction of the error by GMS against Stribeck compensation, mean over both disturbances [%]."""

    reference: str
    paper_percent: float
    best_width_percent: float
    natural_width_percent: float


class ContinuousRun(NamedTuple):
    """The law in continuous time in one place, with the bounds (44) to (46).

    Attributes:
        reference, disturbance: the place.
        start_s, start_error_n: |s| and error at the start [MPa/s], [N].
        reached_s, reaching_bound_s: time until |s| stays within b/h, and its bound (46) [s].
        sliding_s, sliding_bound_s: time to converge (45) with s = 0, and with the largest remaining |s| [s].
        converged_s: time until the error stays within (44) [s].
        paper_bound_s, convergence_bound_s: reaching bound plus either time of (45) [s].
        largest_s, s_bound: largest |s| after the bound is reached, and b/h [MPa/s].
        largest_error_n, error_bound_n: largest error after convergence, and (44) [N].
        holds: whether both time bounds are satisfied.
        time_s, s_line, error_line_n: envelopes of |s| and error over time.
    """

    reference: str
    disturbance: str
    start_s: float
    start_error_n: float
    reached_s: float
    reaching_bound_s: float
    sliding_s: float
    sliding_bound_s: float
    converged_s: float
    paper_bound_s: float
    convergence_bound_s: float
    largest_s: float
    s_bound: float
    largest_error_n: float
    error_bound_n: float
    holds: bool
    time_s: tuple[float, ...]
    s_line: tuple[float, ...]
    error_line_n: tuple[float, ...]


class SamplingLine(NamedTuple):
    """Error at each sampling period."""

    reference: str
    discretisation: str
    errors_n: tuple[float, ...]


class Sampling(NamedTuple):
    """Error against sampling period.

    Attributes:
        periods_s: the periods [s].
        lines: one per reference and discretisation.
        explicit_limit_s: largest stable period of the explicit discretisation in theory [s].
    """

    periods_s: tuple[float, ...]
    lines: tuple[SamplingLine, ...]
    explicit_limit_s: float


class DriftRun(NamedTuple):
    """One kind of adaptation in one place, with or without drifting friction."""

    adaptation: str
    drifts: bool
    reference: str
    disturbance: str
    max_error_n: float
    rms_error_n: float


class TriedChoice(NamedTuple):
    """One open setting with an alternative value.

    Attributes:
        what: the setting.
        controller: the controller used.
        ours, other: the value of Table 3, and the value tried.
        errors_n: error by reference and disturbance.
    """

    what: str
    controller: str
    ours: str
    other: str
    errors_n: Mapping[str, float]


class CoefficientOff(NamedTuple):
    """FASMC II with an error in one coefficient of the plant.

    Attributes:
        section, parameter: the coefficient.
        factor: the plant's value over the controller's.
        errors_n: error in each place.
    """

    section: str
    parameter: str
    factor: float
    errors_n: tuple[float, ...]


@dataclass(frozen=True)
class Draws:
    """FASMC II with all coefficients drawn at random.

    Attributes:
        count: number of rigs drawn.
        spread: largest relative deviation of a coefficient.
        diverged: number of rigs on which a run diverged.
        median, p95, max: quantiles of the error in each place.
    """

    count: int
    spread: float
    diverged: int
    median: tuple[float, ...]
    p95: tuple[float, ...]
    max: tuple[float, ...]


class Robustness(NamedTuple):
    """FASMC II on a rig other than the one it was designed for; ``cells`` are the places of all errors."""

    cells: tuple[Place, ...]
    parameters: tuple[CoefficientOff, ...]
    draws: Draws


class Theory(NamedTuple):
    """Bounds and rates by (44) to (46) with the paper's numbers.

    Attributes:
        s_bound_mpa_s: b/h [MPa/s].
        error_bound_n: (44) [N].
        reaching_rate_1_s: rate K of the robust term [1/s].
        gain_times_period: K times the sampling period of Table 3.
        slope_mpa_s: k/2 [MPa/s].
    """

    s_bound_mpa_s: float
    error_bound_n: float
    reaching_rate_1_s: float
    gain_times_period: float
    slope_mpa_s: float


class FrictionCurves(NamedTuple):
    """Identified friction as in the paper's Figures 4 and 5.

    Attributes:
        velocity_m_s, steady_force_n: Stribeck curve with its viscous part.
        displacement_m, hysteresis_n: hysteresis loop.
        elements_n: force of each element along the loop.
    """

    velocity_m_s: tuple[float, ...]
    steady_force_n: tuple[float, ...]
    displacement_m: tuple[float, ...]
    hysteresis_n: tuple[float, ...]
    elements_n: tuple[tuple[float, ...], ...]


class Beyond(NamedTuple):
    """Results of the complete study beyond Table 3."""

    searches: Searches
    reductions: tuple[Reduction, ...]
    continuous: tuple[ContinuousRun, ...]
    sampling: Sampling
    drift: tuple[DriftRun, ...]
    choices: tuple[TriedChoice, ...]
    robustness: Robustness


class Results(NamedTuple):
    """All results.

    Attributes:
        version: version of this package.
        quick: whether this is the quick study.
        diverged_above_n: steady error above which a run counts as diverged [N].
        cells: Table 3.
        beyond: results of the complete study beyond Table 3; None for the quick study.
        theory: bounds and rates.
        friction: the identified friction.
        figures: the runs in each figure of the paper, by its number.
        wall_s: wall time of the study [s].
        compile_s: wall time of compiling or loading the kernels [s].
    """

    version: str
    quick: bool
    diverged_above_n: float
    cells: tuple[CellResult, ...]
    beyond: Beyond | None
    theory: Theory
    friction: FrictionCurves
    figures: Mapping[str, tuple[Cell, ...]]
    wall_s: float
    compile_s: float


def reproduction_document(results: Results) -> dict[str, Any]:
    """Return the content of ``reproduction.json``: all fields on one level, a cell or place as a list of its names."""
    document: dict[str, Any] = json_document(results)
    beyond = document.pop("beyond") or {}
    for section in beyond.keys() & {"searches", "robustness"}:
        beyond[section]["cells"] = [list(place.values()) for place in beyond[section]["cells"]]
    document["figures"] = {number: [list(cell.values()) for cell in cells] for number, cells in document["figures"].items()}
    return document | beyond


def table3_document(results: Results) -> dict[str, Any]:
    """Return the content of ``table3.json``."""
    return {"cells": json_document(results.cells)}
