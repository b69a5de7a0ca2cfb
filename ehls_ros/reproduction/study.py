"""Complete study: the runs of all questions in one list for all processors, all results in one record."""

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ehls_ros import __version__
from ehls_ros.control.bounds import force_error_bound
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.experiments.causal_limit import with_causal_limit
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.parallel import Progress, Task, run_tasks
from ehls_ros.reproduction import (
    choices,
    continuous,
    drift,
    paper,
    robustness,
    sampling,
    searches,
)
from ehls_ros.reproduction.cases import AS_PUBLISHED, DIVERGED, Change, case, largest_errors, paper_rig, run
from ehls_ros.reproduction.paper import CELLS, Cell
from ehls_ros.reproduction.results import (
    Beyond,
    CellResult,
    FrictionCurves,
    Place,
    Reduction,
    Results,
    Searches,
    Theory,
    TriedWidth,
)
from ehls_ros.trajectory import Trajectory

QUICK = ("constant", "sine")
"""References of the quick study."""

FASTEST = 0.15
"""Largest velocity of the paper's sweep [m/s]."""

STROKE, FREQUENCY = 1.2e-3, 0.1
"""Amplitude [m] and frequency [Hz] of the small sine; the paper gives no frequency."""

PERIOD = 1e-3


class Study(NamedTuple):
    """Results of the study.

    Attributes:
        results: all numbers.
        runs: the runs of Table 3.
    """

    results: Results
    runs: Mapping[Cell, Trajectory]


def compile_everything(workers: int | None = None) -> float:
    """Compile (or load) all kernels of the study.

    Returns:
        Wall time [s].
    """
    start = time.perf_counter()
    short = {"duration": 0.01}
    heated = {**short, "effects": [{"name": "temperature_dependent_friction"}]}
    kernels: list[Task] = [
        *(partial(run, Cell(controller, "constant", "fd1"), Change(short)) for controller in paper.CONTROLLERS),
        partial(run, Cell(paper.FASMC_2, "constant", "fd1"), Change(heated)),
        partial(largest_errors, [(cell, Change(short)) for cell in robustness.CELLS]),
    ]
    run_tasks(kernels, workers)
    return time.perf_counter() - start


def reproduce(
    *, quick: bool = False, workers: int | None = None, progress: Progress | None = None, compile_s: float = 0.0
) -> Study:
    """Run the study.

    Args:
        quick: whether to run only Table 3 for the constant and the sine reference.
        workers: number of processes; None: one per processor.
        progress: called with the number of tasks done, of one or several runs each, and the total number.
        compile_s: wall time of :func:`compile_everything`, for the results [s].
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
            "robustness": robustness.tasks(),
        }
    sections["table"] = [partial(run, cell, AS_PUBLISHED) for cell in cells]
    tasks = [task for section in sections.values() for task in section]
    done = iter(run_tasks(tasks, workers, progress))
    out = {name: [next(done) for _ in section] for name, section in sections.items()}
    runs = dict(zip(cells, out["table"], strict=True))
    table = tuple(cell_result(cell, trajectory) for cell, trajectory in runs.items())
    beyond = None
    if not quick:
        found = searches.summary(out["searches"])
        beyond = Beyond(
            found,
            reductions(table, found),
            tuple(out["continuous"]),
            sampling.summary(out["sampling"]),
            drift.summary(out["drift"]),
            choices.summary(out["choices"]),
            robustness.summary(out["robustness"]),
        )
    results = Results(
        version=__version__,
        quick=quick,
        diverged_above_n=DIVERGED,
        cells=table,
        beyond=beyond,
        theory=theory(),
        friction=friction_curves(),
        figures={str(number): shown for number, shown in paper.FIGURES.items()},
        wall_s=time.perf_counter() - start,
        compile_s=compile_s,
    )
    return Study(results, runs)


def cell_result(cell: Cell, trajectory: Trajectory) -> CellResult:
    """Return one cell of Table 3 from its run."""
    metrics = with_causal_limit(evaluate(trajectory), trajectory)
    return CellResult(
        *cell,
        max_error_n=metrics.max_error_n,
        rms_error_n=metrics.rms_error_n,
        relative_percent=100.0 * metrics.max_error_n / paper.FULL_SCALE,
        paper_percent=paper.RELATIVE_ERROR[cell],
        convergence_s=metrics.convergence_s,
        convergence_band_n=metrics.convergence_band_n,
        oscillation_n=metrics.oscillation_n,
        paper_convergence_s=paper.CONVERGENCE[cell],
        causal_limit_n=metrics.causal_limit_n,
    )


def reductions(cells: Sequence[CellResult], found: Searches) -> tuple[Reduction, ...]:
    """Return the reduction of the error by GMS against Stribeck compensation, mean over both disturbances [%].

    Args:
        cells: Table 3, FASMC II included.
        found: result of the searches, with FASMC I at every width.
    """
    gms = {Place(c.reference, c.disturbance): c.max_error_n for c in cells if c.controller == paper.FASMC_2}

    def mean_reduction(tried: TriedWidth, reference: str) -> float:
        stribeck = dict(zip(found.cells, tried.errors_n, strict=True))
        places = [Place(reference, disturbance) for disturbance in paper.DISTURBANCES]
        return float(100.0 * np.mean([1.0 - gms[place] / stribeck[place] for place in places]))

    return tuple(
        Reduction(
            reference,
            paper.REDUCTION[reference],
            mean_reduction(found.stribeck_best, reference),
            mean_reduction(found.stribeck_natural, reference),
        )
        for reference in paper.REFERENCES
    )


def theory() -> Theory:
    """Return the bounds and rates by (44) to (46) with the paper's numbers."""
    spec = case(Cell(paper.FASMC_2, "constant", "fd1"))
    p = spec.controller.parameters
    rate = continuous.paper_quantities(spec)["rate"]
    return Theory(
        s_bound_mpa_s=p.b / p.h,
        error_bound_n=force_error_bound(p.k, p.g, p.h, p.b, paper_rig().plant.piston_area),
        reaching_rate_1_s=rate,
        gain_times_period=rate * spec.settings.control_period,
        slope_mpa_s=0.5 * p.k,
    )


def friction_curves() -> FrictionCurves:
    """Return the identified friction as in the paper's Figures 4 and 5: Stribeck curve and hysteresis loop."""
    rig = paper_rig()
    friction = rig.friction
    velocity = np.linspace(-FASTEST, FASTEST, 602)
    level = np.array([rig.friction_level(v) for v in velocity])
    steady = np.sign(velocity) * level + friction.viscous_coefficient * velocity

    # Two periods: the first starts from rest and leads to the loop.
    time = np.arange(round(2.0 / FREQUENCY / PERIOD)) * PERIOD
    omega = 2.0 * np.pi * FREQUENCY
    displacement, speed = STROKE * np.sin(omega * time), STROKE * omega * np.cos(omega * time)
    estimator = FrictionEstimator("gms", rig, PERIOD)
    elements = len(friction.element_stiffness)
    rows = np.array([estimator.update(v)[: 2 + elements].copy() for v in speed])[::20]
    return FrictionCurves(
        velocity_m_s=tuple(velocity.tolist()),
        steady_force_n=tuple(steady.tolist()),
        displacement_m=tuple(displacement[::20].tolist()),
        hysteresis_n=tuple(rows[:, 0].tolist()),
        elements_n=tuple(map(tuple, rows[:, 2:].T.tolist())),
    )
