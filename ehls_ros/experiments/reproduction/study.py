"""The whole study: every question's runs in one list for all processors, every answer in one mapping."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ehls_ros import __version__
from ehls_ros.control.bounds import force_error_bound
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.reproduction import (
    choices,
    continuous,
    drift,
    friction,
    paper,
    robustness,
    sampling,
    searches,
)
from ehls_ros.experiments.reproduction.cases import AS_PUBLISHED, DIVERGED, Change, case, paper_rig, run
from ehls_ros.experiments.reproduction.paper import CELLS, Cell
from ehls_ros.experiments.reproduction.pool import Progress, Task, run_tasks
from ehls_ros.trajectory import Trajectory

QUICK = ("constant", "sine")
"""References of the quick study."""


class Study(NamedTuple):
    """What came out.

    Attributes:
        results: every figure, as plain numbers.
        runs: the runs of Table 3, for pictures.
    """

    results: dict[str, Any]
    runs: dict[Cell, Trajectory]


def compile_everything(workers: int | None = None) -> float:
    """Compile (or load) every kernel the study needs.

    Returns:
        Wall time [s].
    """
    start = time.perf_counter()
    short = {"duration": 0.01}
    heated = {**short, "effects": [{"name": "temperature_dependent_friction"}]}
    kernels: list[Task] = [
        *(partial(run, Cell(controller, "constant", "fd1"), Change(short)) for controller in paper.CONTROLLERS),
        partial(run, Cell(paper.FASMC_2, "constant", "fd1"), Change(heated)),
    ]
    run_tasks(kernels, workers)
    return time.perf_counter() - start


def reproduce(*, quick: bool = False, workers: int | None = None, progress: Progress | None = None) -> Study:
    """Run the study.

    Args:
        quick: Table 3 for the constant and the sine alone.
        workers: processes; None: one a processor.
        progress: called with the runs done and the runs in all.
    """
    start = time.perf_counter()
    cells = [cell for cell in CELLS if not quick or cell.reference in QUICK]
    sections: dict[str, list[Task]] = {}
    if not quick:
        sections = {
            "continuous": continuous.tasks(),
            "sampling": sampling.tasks(),
            "drift": drift.tasks(),
            "searches": searches.tasks(),
            "choices": choices.tasks(),
            "single": robustness.one_at_a_time(),
            "draws": robustness.drawn(),
        }
    sections["table"] = [partial(run, cell, AS_PUBLISHED) for cell in cells]
    tasks = [task for section in sections.values() for task in section]
    done = iter(run_tasks(tasks, workers, progress))
    out = {name: [next(done) for _ in section] for name, section in sections.items()}
    runs = dict(zip(cells, out["table"], strict=True))
    results: dict[str, Any] = {
        "version": __version__,
        "quick": quick,
        "diverged_above_n": DIVERGED,
        "cells": [cell_row(cell, trajectory) for cell, trajectory in runs.items()],
    }
    if not quick:
        found = searches.summary(out["searches"])
        results |= {
            "searches": found,
            "reductions": reductions(results["cells"], found),
            "continuous": out["continuous"],
            "sampling": sampling.summary(out["sampling"]),
            "drift": drift.summary(out["drift"]),
            "choices": choices.summary(out["choices"]),
            "robustness": robustness.summary(out["single"], out["draws"]),
        }
    figures = {str(number): [list(cell) for cell in shown] for number, shown in paper.FIGURES.items()}
    results |= {"theory": theory(), "friction": friction.curves(), "figures": figures}
    results["wall_s"] = time.perf_counter() - start
    return Study(results, runs)


def cell_row(cell: Cell, trajectory: Trajectory) -> dict[str, Any]:
    """Return one cell of ``table3.json``."""
    metrics = evaluate(trajectory)
    return {
        **cell._asdict(),
        "max_error_n": metrics.max_error_n,
        "rms_error_n": metrics.rms_error_n,
        "relative_percent": 100.0 * metrics.max_error_n / paper.FULL_SCALE,
        "paper_percent": paper.RELATIVE_ERROR[cell],
        "convergence_s": metrics.convergence_s,
        "convergence_band_n": metrics.convergence_band_n,
        "oscillation_n": metrics.oscillation_n,
        "paper_convergence_s": paper.CONVERGENCE[cell],
    }


def reductions(cells: Sequence[dict[str, Any]], found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return by how much GMS lowers the error against Stribeck, mean over both disturbances [%].

    Args:
        cells: rows of Table 3, FASMC II among them.
        found: result of the searches, which holds FASMC I at every width.
    """
    gms = {(row["reference"], row["disturbance"]): row["max_error_n"] for row in cells if row["controller"] == paper.FASMC_2}
    keys = [(reference, disturbance) for reference, disturbance in found["cells"]]

    def mean_reduction(width: dict[str, Any], reference: str) -> float:
        stribeck = dict(zip(keys, width["errors_n"], strict=True))
        parts = [1.0 - gms[reference, d] / stribeck[reference, d] for d in paper.DISTURBANCES]
        return float(100.0 * np.mean(parts))

    return [
        {
            "reference": reference,
            "paper_percent": paper.REDUCTION[reference],
            "best_width_percent": mean_reduction(found["stribeck_best"], reference),
            "natural_width_percent": mean_reduction(found["stribeck_natural"], reference),
        }
        for reference in paper.REFERENCES
    ]


def theory() -> dict[str, float]:
    """Return the bounds and rates that (44)-(46) give with the paper's numbers."""
    spec = case(Cell(paper.FASMC_2, "constant", "fd1"))
    p = spec.controller.parameters
    quantities = continuous.paper_quantities(spec)
    return {
        "s_bound_mpa_s": p.b / p.h,
        "error_bound_n": force_error_bound(p.k, p.g, p.h, p.b, paper_rig().plant.piston_area),
        "reaching_rate_1_s": quantities["rate"],
        "gain_times_period": quantities["rate"] * spec.settings.control_period,
        "slope_mpa_s": 0.5 * p.k,
    }
