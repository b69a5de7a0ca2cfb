"""The volume balance (2): discharge coefficient and bulk modulus, from spool, pressure and position.

Over a block of cycles the oil that the valve lets through moves the piston, is compressed, and leaks:

    Cd w int q dt = Ac dx + Vt/(4 beta_e) dpL + Ctc int pL dt,    q = sqrt((ps - sgn(xv) pL)/rho) xv

so no reading is differentiated, and the velocity's is not needed. With the rig file's coefficients on both sides, the
regression tells Ac/Cd, Vt/(beta_e Cd) and Ctc/Cd relative to the rig file, and an offset, the spool's bias. The area is known
from the load cell. Valve area gradient and density are part of what is called the discharge coefficient, the volume of the
bulk modulus: only the products are seen.
"""

import math
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.adaptation.least_squares import gather, solve, whole
from ehls_ros.control.controllers.base import Model, Noise
from ehls_ros.physics.parameters import Plant

BLOCK = 10
"""Cycles in a block."""

ROW = 5
"""Entries of a row: volumes of motion, compression, leakage and offset, and the volume through the valve [m^3]."""

STARTED, THROUGH, LEAKED, LAST_FLOW, LAST_PRESSURE, FIRST_POSITION, FIRST_PRESSURE, OPEN = range(8)
"""Where an open block holds its cycles, volumes [m^3], last flow [m^3/s] and pressure [Pa], and its start; its length."""

OFFSET_FLOW = 1e-6
"""Size of the offset for the sums [m^3/s]."""

LEAKAGE_KNOWN = 1.0
"""Standard deviation of the leakage's relative error before anything is measured."""

FLOW_FLOOR, COMPRESSION_FLOOR = 1e-3, 1e-2
"""Least standard errors of discharge coefficient and bulk modulus: what the trapezoidal rule over a cycle leaves."""

LEAST_DROP = 0.01
"""Least pressure drop over the valve that counts, as a fraction of the supply pressure."""


class Found(NamedTuple):
    """What the flow turns out to be, over the rig file's, with standard errors.

    Attributes:
        discharge, discharge_std: discharge coefficient per piston area.
        compression, compression_std: volume over bulk modulus, per piston area.
    """

    discharge: float
    discharge_std: float
    compression: float
    compression_std: float


@kernel
def valve_flow(spool: float, pressure: float, supply: float, plant: Plant) -> float:
    """Return the flow (1) [m^3/s]; NaN where the drop is too small to tell it."""
    drop = supply - math.copysign(pressure, spool * pressure)
    if drop < LEAST_DROP * plant.supply_pressure:
        return math.nan
    return plant.discharge_coefficient * plant.valve_area_gradient * spool * math.sqrt(drop / plant.oil_density)


@kernel
def begin(position: float, pressure: float, flow: float, block: Array) -> None:
    """Open a block at a reading; without it if that is not finite."""
    block[STARTED] = 1.0 if math.isfinite(position + pressure + flow) else 0.0
    block[THROUGH] = block[LEAKED] = 0.0
    block[LAST_FLOW], block[LAST_PRESSURE] = flow, pressure
    block[FIRST_POSITION], block[FIRST_PRESSURE] = position, pressure


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
    """Take in one cycle.

    Args:
        position: [m].
        pressure: load pressure [Pa].
        flow: through the valve by the rig file's coefficients [m^3/s].
        plant: the rig file's coefficients.
        period: of the cycles [s].
        fading: what remains of earlier blocks' weight.
        block: the open block, shape (OPEN,); updated.
        row: scratch, shape (ROW,).
        sums, count: of :func:`~ehls_ros.control.adaptation.least_squares.gather`.
    """
    if block[STARTED] == 0.0 or not math.isfinite(position + pressure + flow):
        begin(position, pressure, flow, block)
        return
    block[STARTED] += 1.0
    block[THROUGH] += 0.5 * period * (flow + block[LAST_FLOW])
    block[LEAKED] += 0.5 * period * plant.leakage_coefficient * (pressure + block[LAST_PRESSURE])
    block[LAST_FLOW], block[LAST_PRESSURE] = flow, pressure
    if block[STARTED] <= BLOCK:
        return
    row[0] = plant.piston_area * (position - block[FIRST_POSITION])
    row[1] = plant.total_volume / (4.0 * plant.bulk_modulus) * (pressure - block[FIRST_PRESSURE])
    row[2] = block[LEAKED]
    row[3] = OFFSET_FLOW * BLOCK * period
    row[4] = block[THROUGH]
    gather(row, fading, sums, count)
    begin(position, pressure, flow, block)


def find(model: Model, sums: Array, count: float) -> Found | None:
    """Return the flow that explains the blocks, against the rig file's ``model``; None where they do not tell it."""
    # A rig without leakage in its file has no size for it.
    used = [0, 1, 2, 3, 4] if model.plant.leakage_coefficient > 0.0 else [0, 1, 3, 4]
    prior = np.array([0.0, 0.0, 1.0 / LEAKAGE_KNOWN, 0.0])
    centre = np.array([0.0, 0.0, 1.0, 0.0])
    kept = used[:-1]
    sums = whole(sums)[np.ix_(used, used)]
    # About the rig file's leakage, so that the prior means it.
    shift = np.eye(len(used))
    shift[:-1, -1] = -centre[kept]
    sums = shift.T @ sums @ shift
    fit = solve(sums, count, _noise(model.plant, model.noise)[kept], prior[kept])
    if fit is None or fit.values[0] <= 0.1:
        return None
    motion, compressed = fit.values[0], fit.values[1]
    unit = np.eye(len(kept))
    return Found(
        1.0 / motion,
        math.hypot(fit.std(unit[0]) / motion**2, FLOW_FLOOR),
        compressed / motion,
        math.hypot(fit.std(unit[1] - compressed / motion * unit[0]) / motion, COMPRESSION_FLOOR),
    )


def _noise(plant: Plant, noise: Noise) -> Array:
    """Return the variance of each regressor's noise, a difference of two readings."""
    moved = plant.piston_area * noise.position
    compressed = plant.total_volume / (4.0 * plant.bulk_modulus) * noise.load_pressure
    return 2.0 * np.array([moved, compressed, 0.0, 0.0]) ** 2
