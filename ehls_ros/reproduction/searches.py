"""Optimisation of the competitors: gains of structure invariance compensation, width of the smoothed Stribeck curve.

Both are ranked by the largest steady error over all references and disturbances, as one tuning applies to all.
"""

import math
from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.margins import pressure_loop_margins
from ehls_ros.parallel import Task
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import Change, largest_error, paper_rig
from ehls_ros.reproduction.paper import Cell
from ehls_ros.reproduction.results import Place, Searches, TriedGains, TriedWidth

GAINS = (
    *product((50.0, 100.0, 150.0, 200.0, 240.0, 260.0, 270.0, 280.0), (0.0, 50.0, 100.0, 150.0, 200.0, 300.0, 1000.0)),
    *product((400.0, 700.0, 1000.0, 2000.0, 3000.0), (0.0, 1000.0)),
)
"""Proportional [1/s] and integral gains [1/s^2] tried; the last ones have no stability margin."""

GAIN_MARGIN_DB, PHASE_MARGIN_DEG = 6.0, 30.0
"""Minimum stability margins of a loop on a rig."""

SMOOTHING = tuple(float(width) for width in 1e-3 * np.array([1, 2, 5, 10, 20, 50, 100, 200, 300, 500, 1000, 10_000]))
"""Widths tried of the smoothed Stribeck curve [m/s]."""

NATURAL_SMOOTHING = 0.01
"""Width of five Stribeck velocities, which reproduces the paper's FASMC I errors [m/s]."""

MOVING = tuple(Place(*place) for place in product(paper.REFERENCES, paper.DISTURBANCES))


def tasks() -> list[Task]:
    """Return the runs of both searches."""
    sic = [
        partial(largest_error, Cell(paper.SIC, r, d), Change({"controller": {"proportional": p, "integral": i}}))
        for p, i in GAINS
        for r, d in MOVING
    ]
    stribeck = [
        partial(largest_error, Cell(paper.FASMC_1, r, d), Change({"compensation": {"smoothing": width}}))
        for width in SMOOTHING
        for r, d in MOVING
    ]
    return [*sic, *stribeck]


def summary(results: Sequence[float]) -> Searches:
    """Return the result of both searches, from the results of :func:`tasks`."""
    errors = np.reshape(results, (-1, len(MOVING)))
    rig = paper_rig()
    gains = []
    for (p, i), row in zip(GAINS, errors, strict=False):
        margins = pressure_loop_margins(p, i, rig.plant.valve_bandwidth, 1e-3)
        admissible = margins.gain_db >= GAIN_MARGIN_DB and margins.phase_deg >= PHASE_MARGIN_DEG
        gains.append(TriedGains(p, i, margins.gain_db, margins.phase_deg, admissible, *_errors(row)))
    widths = [TriedWidth(width, *_errors(row)) for width, row in zip(SMOOTHING, errors[len(gains) :], strict=True)]
    return Searches(
        cells=MOVING,
        sic=tuple(gains),
        sic_best=min((tried for tried in gains if tried.admissible), key=_worst),
        sic_best_without_margins=min(gains, key=_worst),
        stribeck=tuple(widths),
        stribeck_best=min(widths, key=_worst),
        stribeck_natural=next(tried for tried in widths if math.isclose(tried.smoothing_m_s, NATURAL_SMOOTHING)),
    )


def _errors(row: Array) -> tuple[tuple[float, ...], float]:
    return tuple(map(float, row)), float(row.max())


def _worst(tried: TriedGains | TriedWidth) -> float:
    return tried.worst_n
