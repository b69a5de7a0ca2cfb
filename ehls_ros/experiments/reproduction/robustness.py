"""FASMC II on a rig other than the one it was told of."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ehls_ros.experiments.reproduction import paper
from ehls_ros.experiments.reproduction.cases import Change, largest_error, paper_rig
from ehls_ros.experiments.reproduction.pool import Task
from ehls_ros.physics.friction.gms import Parameters as Friction

CELLS = tuple(cell for cell in paper.CELLS if cell.controller == paper.FASMC_2)

FACTORS = (0.8, 1.2)
"""What each coefficient is multiplied with, one at a time."""

DRAWS, SPREAD, SEED = 100, 0.1, 2018
"""Rigs drawn at random, how far each coefficient may lie from its own, and the seed."""

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


def summary(single: Sequence[float], draws: Sequence[float]) -> dict[str, Any]:
    """Return the table, from the results of :func:`one_at_a_time` and :func:`drawn`; an infinite error diverged."""
    rows = np.reshape(single, (-1, len(CELLS)))
    keys = [(section, name, factor) for section, name in coefficients() for factor in FACTORS]
    table = [
        {"section": section, "parameter": name, "factor": factor, "errors_n": [float(e) for e in row]}
        for (section, name, factor), row in zip(keys, rows, strict=True)
    ]
    errors = np.reshape(draws, (-1, len(CELLS)))
    return {
        "cells": [[cell.reference, cell.disturbance] for cell in CELLS],
        "parameters": table,
        "draws": {
            "count": len(errors),
            "spread": SPREAD,
            "diverged": int(np.sum(~np.isfinite(errors).all(axis=1))),
            # Picked, not interpolated: an infinite error has no neighbours to lie between.
            **{
                name: np.quantile(errors, q, axis=0, method="inverted_cdf").tolist()
                for name, q in (("median", 0.5), ("p95", 0.95), ("max", 1.0))
            },
        },
    }
