"""Estimate discharge coefficient and bulk modulus by the volume balance (2), from spool, pressure and position.

Over a block of cycles, the oil through the valve moves the piston, is compressed, and leaks:

    Cd w int q dt = Ac dx + Vt/(4 beta_e) dpL + Ctc int pL dt,    q = sqrt((ps - sgn(xv) pL)/rho) xv

No reading is differentiated, and no velocity reading is needed. With the rig file's coefficients on both sides, the regression
yields Ac/Cd, Vt/(beta_e Cd) and Ctc/Cd relative to the rig file, and an offset, the spool's bias. The area is known from the
load cell. Only products are identifiable: valve area gradient and density are included in the discharge coefficient, the volume
in the bulk modulus. Of a cylinder with two chambers, each cycle takes the double rod that it is at that moment
(:mod:`ehls_ros.control.local_plant`): the discharge coefficient stands for the gains of all edges, the bulk modulus for both
chambers.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.adaptation.least_squares import above_noise, gather, solve, symmetric
from ehls_ros.control.controllers.base import Model, Noise
from ehls_ros.physics.parameters import Plant

BLOCK = 10
"""Cycles in a block."""

MOTION, COMPRESSION, LEAKAGE, OFFSET, VALVE, ROW = range(6)
"""Volumes in a row [m^3]: motion, compression, leakage, offset, and flow through the valve; and their number."""

MIN_MOTION = 0.1
"""Least plausible ratio of area to discharge coefficient, relative to the rig file's."""

STARTED, THROUGH, LEAKED, COMPRESSED, LAST_FLOW, LAST_PRESSURE, FIRST_POSITION, OPEN = range(8)
"""Indices of an open block: its cycles, volumes [m^3], last flow [m^3/s] and pressure [Pa], and its start; and its length."""

OFFSET_FLOW = 1e-6
"""Scale of the offset in the sums [m^3/s]."""

LEAKAGE_PRIOR_STD = 1.0
"""Prior standard deviation of the leakage's relative error."""

FLOW_FLOOR, COMPRESSION_FLOOR = 1e-3, 1e-2
"""Least standard errors of discharge coefficient and bulk modulus, due to the trapezoidal rule over a cycle."""


class Found(NamedTuple):
    """Estimates of the flow stage relative to the rig file, with standard errors.

    Attributes:
        discharge, discharge_std: discharge coefficient per piston area.
        compression, compression_std: volume over bulk modulus, per piston area.
    """

    discharge: float
    discharge_std: float
    compression: float
    compression_std: float


@kernel
def begin(position: float, pressure: float, flow: float, block: Array) -> None:
    """Open a block at a reading, or none if the reading is not finite."""
    block[STARTED] = 1.0 if math.isfinite(position + pressure + flow) else 0.0
    block[THROUGH] = block[LEAKED] = block[COMPRESSED] = 0.0
    block[LAST_FLOW], block[LAST_PRESSURE] = flow, pressure
    block[FIRST_POSITION] = position


@kernel
def balance(
    position: float,
    pressure: float,
    flow: float,
    plant: Plant,
    period: float,
    fading: float,
    block: Array,
    row: Array,
    sums: Array,
    count: Array,
) -> None:
    """Add one cycle to the open block, and the completed block to the sums.

    Args:
        position: piston position [m].
        pressure: load pressure [Pa].
        flow: flow through the valve by the rig file's coefficients [m^3/s].
        plant: the rig file's coefficients; of a cylinder with two chambers, those of the double rod that it is.
        period: control period [s].
        fading: forgetting factor of earlier blocks' weight.
        block: the open block, shape (OPEN,); updated.
        row: scratch, shape (ROW,).
        sums: sums of :func:`~ehls_ros.control.adaptation.least_squares.gather`.
        count: total weight of the sums.
    """
    if block[STARTED] == 0.0 or not math.isfinite(position + pressure + flow):
        begin(position, pressure, flow, block)
        return
    block[STARTED] += 1.0
    block[THROUGH] += 0.5 * period * (flow + block[LAST_FLOW])
    block[LEAKED] += 0.5 * period * plant.leakage_coefficient * (pressure + block[LAST_PRESSURE])
    block[COMPRESSED] += plant.total_volume / (4.0 * plant.bulk_modulus) * (pressure - block[LAST_PRESSURE])
    block[LAST_FLOW], block[LAST_PRESSURE] = flow, pressure
    if block[STARTED] <= BLOCK:
        return
    row[MOTION] = plant.piston_area * (position - block[FIRST_POSITION])
    row[COMPRESSION] = block[COMPRESSED]
    row[LEAKAGE] = block[LEAKED]
    row[OFFSET] = OFFSET_FLOW * BLOCK * period
    row[VALVE] = block[THROUGH]
    gather(row, fading, sums, count)
    begin(position, pressure, flow, block)


def find(model: Model, sums: Array, count: float) -> Found | None:
    """Return the flow estimates from the blocks, relative to the rig file's ``model``; None if not determined."""
    sums, noise = symmetric(sums), _noise(model.plant, model.noise)
    unit = np.eye(ROW - 1)
    free = above_noise(np.diag(sums)[:-1], count, noise)
    # A rig without leakage in its file gives no scale for it.
    free[LEAKAGE] = model.plant.leakage_coefficient > 0.0
    if not free[MOTION]:
        return None
    # Prior about the rig file's leakage, and its compression fixed if the data do not determine it.
    expected = unit[LEAKAGE] + (0.0 if free[COMPRESSION] else unit[COMPRESSION])
    shift = np.eye(ROW)
    shift[:-1, -1] = -expected
    kept = np.flatnonzero(free)
    both = np.append(kept, ROW - 1)
    prior = unit[LEAKAGE] / LEAKAGE_PRIOR_STD
    fit = solve((shift.T @ sums @ shift)[np.ix_(both, both)], count, noise[kept], prior[kept])
    if fit is None or fit.values[MOTION] <= MIN_MOTION:
        return None
    motion = fit.values[MOTION]
    discharge_std = math.hypot(fit.std(unit[MOTION, kept]) / motion**2, FLOW_FLOOR)
    if not free[COMPRESSION]:
        return Found(1.0 / motion, discharge_std, 1.0 / motion, math.inf)
    ratio = fit.values[COMPRESSION] / motion
    ratio_std = fit.std((unit[COMPRESSION] - ratio * unit[MOTION])[kept]) / motion
    return Found(1.0 / motion, discharge_std, ratio, math.hypot(ratio_std, COMPRESSION_FLOOR))


def _noise(plant: Plant, noise: Noise) -> Array:
    """Return the noise variance of each regressor, a difference of two readings."""
    moved = plant.piston_area * noise.position
    compressed = plant.total_volume / (4.0 * plant.bulk_modulus) * noise.load_pressure
    return 2.0 * np.array([moved, compressed, 0.0, 0.0]) ** 2
