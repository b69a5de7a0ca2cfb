"""Benefit of the adaptation: drifting friction as in warming oil, with and without adaptation."""

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

from ehls_ros.control.controllers import fasmc
from ehls_ros.experiments.metrics import Metrics
from ehls_ros.parallel import Task
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import Change, evaluated, paper_rig
from ehls_ros.reproduction.paper import Cell
from ehls_ros.reproduction.results import DriftRun

DURATION = 20.0
"""Duration of the friction drift [s]."""

COULOMB, VISCOUS = 1.3, 0.6
"""Factors on Coulomb and viscous friction at the end."""

WARMING = 1.0
"""Rate of the oil's temperature [K/s]; the slopes below scale with it."""

OFF: dict[str, float] = {"phi1": 0.0, "phi2": 0.0}
ADAPTATIONS: dict[str, dict[str, float]] = {
    paper.EVERYTHING: {},
    paper.TENFOLD: {"phi1": 10.0 * fasmc.Parameters().phi1, "phi2": 10.0 * fasmc.Parameters().phi2},
    paper.DELTA_ALONE: OFF,
    paper.SCALES_ALONE: {"phi3": 0.0},
    paper.NO_ADAPTATION: {**OFF, "phi3": 0.0},
}

CASES = tuple(Cell(paper.FASMC_2, r, d) for r in ("constant", "sine") for d in paper.DISTURBANCES)


def tasks() -> list[Task]:
    """Return the runs, with drift and without."""
    return [
        partial(evaluated, cell, Change({**(_drift() if drifts else {}), "duration": DURATION, "controller": adaptation}))
        for adaptation, drifts, cell in product(ADAPTATIONS.values(), (True, False), CASES)
    ]


def _drift() -> dict[str, Any]:
    friction = paper_rig().friction
    kelvin = WARMING * DURATION
    effect = {
        "name": "temperature_dependent_friction",
        "coulomb_slope": (COULOMB - 1.0) * friction.coulomb_force / kelvin,
        "viscous_slope": (VISCOUS - 1.0) * friction.viscous_coefficient / kelvin,
    }
    return {"effects": [effect], "oil_warming": WARMING}


def summary(results: Sequence[Metrics]) -> tuple[DriftRun, ...]:
    """Return largest and rms error by adaptation and cell, from the results of :func:`tasks`."""
    keys = product(ADAPTATIONS, (True, False), CASES)
    return tuple(
        DriftRun(adaptation, drifts, cell.reference, cell.disturbance, metrics.max_error_n, metrics.rms_error_n)
        for (adaptation, drifts, cell), metrics in zip(keys, results, strict=True)
    )
