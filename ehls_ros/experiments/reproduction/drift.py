"""Whether adaptation earns its place: friction that drifts as warming oil makes it, with and without it."""

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any

from ehls_ros.control.controllers import fasmc
from ehls_ros.experiments.reproduction import paper
from ehls_ros.experiments.reproduction.cases import Change, judged, paper_rig
from ehls_ros.experiments.reproduction.paper import Cell
from ehls_ros.experiments.reproduction.pool import Task

DURATION = 20.0
"""Time over which the friction drifts [s]."""

COULOMB, VISCOUS = 1.3, 0.6
"""What Coulomb and viscous friction are multiplied with at the end."""

WARMING = 1.0
"""Rate of the oil's temperature [K/s]; with the slopes below it only sets the scale."""

OFF: dict[str, float] = {"phi1": 0.0, "phi2": 0.0}
ADAPTATIONS: dict[str, dict[str, float]] = {
    "α̂, β̂ and D̂ adapt": {},
    "α̂, β̂ ten times as fast": {"phi1": 10.0 * fasmc.Parameters().phi1, "phi2": 10.0 * fasmc.Parameters().phi2},
    "D̂ alone adapts": OFF,
    "α̂ and β̂ alone adapt": {"phi3": 0.0},
    "nothing adapts": {**OFF, "phi3": 0.0},
}

CASES = tuple(Cell(paper.FASMC_2, r, d) for r in ("constant", "sine") for d in paper.DISTURBANCES)


def tasks() -> list[Task]:
    """Return the runs, with drift and without."""
    return [
        partial(judged, cell, Change({**(_drift() if drifts else {}), "duration": DURATION, "controller": adaptation}))
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


def summary(results: Sequence[Any]) -> list[dict[str, Any]]:
    """Return largest and rms error by adaptation and cell, from the results of :func:`tasks`."""
    keys = product(ADAPTATIONS, (True, False), CASES)
    return [
        {
            "adaptation": adaptation,
            "drifts": drifts,
            "reference": cell.reference,
            "disturbance": cell.disturbance,
            "max_error_n": metrics.max_error_n,
            "rms_error_n": metrics.rms_error_n,
        }
        for (adaptation, drifts, cell), metrics in zip(keys, results, strict=True)
    ]
