"""FASMC II on a rig other than the one it was designed for."""

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from ehls_ros.parallel import Task
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.physics.lane_memory import LANES
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import Change, largest_errors, paper_rig
from ehls_ros.reproduction.results import CoefficientOff, Draws, Place, Robustness

CELLS = tuple(cell for cell in paper.CELLS if cell.controller == paper.FASMC_2)

FACTORS = (0.8, 1.2)
"""Factors on each coefficient, one at a time."""

DRAWS, SPREAD, SEED = 100, 0.1, 2018
"""Number of rigs drawn at random, largest relative deviation of a coefficient, and seed."""

TOGETHER = 4 * LANES
"""Number of runs of one task."""

FRICTION = tuple(name for name in Friction._fields if name not in {"element_stiffness", "element_weight"})
"""The scalar coefficients of the friction."""


def coefficients() -> list[tuple[str, str]]:
    """Return section and name of each varied coefficient; the arm's length is in no equation."""
    plant = [name for name in paper_rig().plant._fields if name != "arm_length"]
    return [*(("plant", name) for name in plant), *(("friction", name) for name in FRICTION)]


Run = tuple[paper.Cell, Change]
"""A cell on another rig."""


def one_at_a_time() -> list[Run]:
    """Return a run per coefficient, factor and cell."""
    return [
        (cell, Change(**{section: {name: factor}})) for section, name in coefficients() for factor in FACTORS for cell in CELLS
    ]


def drawn() -> list[Run]:
    """Return a run per drawn rig and cell."""
    random = np.random.default_rng(SEED)
    runs: list[Run] = []
    for _ in range(DRAWS):
        change: dict[str, dict[str, float]] = {"plant": {}, "friction": {}}
        for section, name in coefficients():
            change[section][name] = float(random.uniform(1.0 - SPREAD, 1.0 + SPREAD))
        runs += [(cell, Change(**change)) for cell in CELLS]
    return runs


def tasks() -> list[Task]:
    """Return tasks for all runs, each with several runs side by side."""
    runs = [*one_at_a_time(), *drawn()]
    return [partial(largest_errors, runs[first : first + TOGETHER]) for first in range(0, len(runs), TOGETHER)]


def summary(results: Iterable[Sequence[float]]) -> Robustness:
    """Return all errors, from the results of :func:`tasks`; an infinite error diverged."""
    rows = np.reshape([error for errors in results for error in errors], (-1, len(CELLS)))
    keys = [(section, name, factor) for section, name in coefficients() for factor in FACTORS]
    rows, errors = rows[: len(keys)], rows[len(keys) :]
    # Not interpolated, as errors may be infinite.
    median, p95, largest = (tuple(np.quantile(errors, q, axis=0, method="inverted_cdf").tolist()) for q in (0.5, 0.95, 1.0))
    return Robustness(
        tuple(Place(cell.reference, cell.disturbance) for cell in CELLS),
        tuple(CoefficientOff(*key, tuple(map(float, row))) for key, row in zip(keys, rows, strict=True)),
        Draws(len(errors), SPREAD, int(np.sum(~np.isfinite(errors).all(axis=1))), median, p95, largest),
    )
