"""FASMC II on a rig other than the one it was designed for."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from ehls_ros.experiments.reproduction import paper
from ehls_ros.experiments.reproduction.cases import Change, largest_error, paper_rig
from ehls_ros.experiments.reproduction.results import CoefficientOff, Draws, Place, Robustness
from ehls_ros.parallel import Task
from ehls_ros.physics.friction.gms import Parameters as Friction

CELLS = tuple(cell for cell in paper.CELLS if cell.controller == paper.FASMC_2)

FACTORS = (0.8, 1.2)
"""Factors on each coefficient, one at a time."""

DRAWS, SPREAD, SEED = 100, 0.1, 2018
"""Number of rigs drawn at random, largest relative deviation of a coefficient, and seed."""

FRICTION = tuple(name for name in Friction._fields if name not in {"element_stiffness", "element_weight"})
"""The friction's coefficients that are single numbers."""


def coefficients() -> list[tuple[str, str]]:
    """Return section and name of each coefficient that is varied; the arm's length enters no equation."""
    plant = [name for name in paper_rig().plant._fields if name != "arm_length"]
    return [*(("plant", name) for name in plant), *(("friction", name) for name in FRICTION)]


def one_at_a_time() -> list[Task]:
    """Return a run a coefficient, factor and cell."""
    return [
        partial(largest_error, cell, Change(**{section: {name: factor}}))
        for section, name in coefficients()
        for factor in FACTORS
        for cell in CELLS
    ]


def drawn() -> list[Task]:
    """Return a run a drawn rig and cell."""
    random = np.random.default_rng(SEED)
    tasks: list[Task] = []
    for _ in range(DRAWS):
        change: dict[str, dict[str, float]] = {"plant": {}, "friction": {}}
        for section, name in coefficients():
            change[section][name] = float(random.uniform(1.0 - SPREAD, 1.0 + SPREAD))
        tasks += [partial(largest_error, cell, Change(**change)) for cell in CELLS]
    return tasks


def summary(single: Sequence[float], draws: Sequence[float]) -> Robustness:
    """Return all errors, from the results of :func:`one_at_a_time` and :func:`drawn`; an infinite error diverged."""
    rows = np.reshape(single, (-1, len(CELLS)))
    keys = [(section, name, factor) for section, name in coefficients() for factor in FACTORS]
    errors = np.reshape(draws, (-1, len(CELLS)))
    # Picked, not interpolated: an infinite error has no neighbours to lie between.
    median, p95, largest = (tuple(np.quantile(errors, q, axis=0, method="inverted_cdf").tolist()) for q in (0.5, 0.95, 1.0))
    return Robustness(
        tuple(Place(cell.reference, cell.disturbance) for cell in CELLS),
        tuple(CoefficientOff(*key, tuple(map(float, row))) for key, row in zip(keys, rows, strict=True)),
        Draws(len(errors), SPREAD, int(np.sum(~np.isfinite(errors).all(axis=1))), median, p95, largest),
    )
