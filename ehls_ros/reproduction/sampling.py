"""Largest error against sampling period, with the robust term stepped explicitly, as printed, and implicitly."""

from collections.abc import Sequence
from functools import partial

from ehls_ros.parallel import Task
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import Change, case, largest_error
from ehls_ros.reproduction.continuous import paper_quantities
from ehls_ros.reproduction.paper import Cell
from ehls_ros.reproduction.results import Sampling, SamplingLine

PERIODS = (5e-6, 1e-5, 1.5e-5, 2e-5, 2.2e-5, 2.4e-5, 3e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 5e-3)
"""Sampling periods [s]."""

DURATION = 4.0
"""Plant time of each run [s]."""

CASES = tuple(Cell(paper.FASMC_2, reference, "fd2") for reference in ("constant", "sine"))
IMPLICITNESS = {"explicit": 0.0, "implicit": 1.0}


def tasks() -> list[Task]:
    """Return the runs."""
    return [
        partial(largest_error, cell, _change(period, theta))
        for cell in CASES
        for theta in IMPLICITNESS.values()
        for period in PERIODS
    ]


def _change(period: float, theta: float) -> Change:
    return Change(
        {
            "control_period": period,
            "duration": DURATION,
            "controller": {"implicitness": theta},
        }
    )


def summary(results: Sequence[float]) -> Sampling:
    """Return the lines of the figure, from the results of :func:`tasks`; an infinite error diverged."""
    size = len(PERIODS)
    keys = [(cell.reference, name) for cell in CASES for name in IMPLICITNESS]
    lines = tuple(SamplingLine(*key, tuple(results[i * size : (i + 1) * size])) for i, key in enumerate(keys))
    rate = paper_quantities(case(CASES[0]))["rate"]
    return Sampling(PERIODS, lines, explicit_limit_s=2.0 / rate)
