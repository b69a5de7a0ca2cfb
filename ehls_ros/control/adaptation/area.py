"""Estimate the piston area from load cell and load pressure: F = Ac pL + o.

A load cell's offset is known to be small, so even a constant force determines the area.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, in_python, kernel
from ehls_ros.control.adaptation.least_squares import gather, solve, symmetric
from ehls_ros.control.controllers.base import Model
from ehls_ros.control.rig_scale import PAPER_FORCE, largest_force

ROW = 3
"""Entries of a row: force by the rig file's area [N], size of the offset [N], force of the load cell [N]."""

OFFSET_PRIOR_STD = 20.0
"""Standard deviation of a load cell's offset on the paper's rig [N], scaled with the rig's force."""

FLOOR = 5e-4
"""Least standard error of the area, due to the linearity of the two sensors."""


class Found(NamedTuple):
    """Piston area relative to the rig file's, and its standard error."""

    area: float
    area_std: float


@kernel
def compare(force: float, pressure: float, area: float, fading: float, row: Array, sums: Array, count: Array) -> None:
    """Add a reading of load cell [N] and load pressure [Pa] to the sums; ``area`` is the rig file's [m^2]."""
    row[0], row[1], row[2] = area * pressure, 1.0, force
    gather(row, fading, sums, count)


def find(model: Model, sums: Array, count: float) -> Found | None:
    """Return the area that fits the load cell; None if the pressure does not determine it. ``model`` is the rig file's."""
    noise = np.array([(model.plant.piston_area * model.noise.load_pressure) ** 2, 0.0])
    known = OFFSET_PRIOR_STD * in_python(largest_force)(model.plant) / PAPER_FORCE
    fit = solve(symmetric(sums), count, noise, np.array([0.0, 1.0 / known]))
    if fit is None or fit.values[0] <= 0.0:
        return None
    return Found(float(fit.values[0]), math.hypot(fit.std(np.array([1.0, 0.0])), FLOOR))
