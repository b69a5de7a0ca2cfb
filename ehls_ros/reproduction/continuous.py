"""Control law in continuous time, compared with the bounds (44) to (46).

The controller is evaluated explicitly at every integration step, short enough to resolve the robust term, whose
rate is 8.8e4 1/s.
"""

import math
from functools import partial

import numpy as np

from ehls_ros.arrays import in_python
from ehls_ros.control.bounds import pressure_error_bound, reaching_rate, reaching_time_bound, remaining_s, sliding_time
from ehls_ros.control.controllers import base, fasmc
from ehls_ros.experiments.loop import ClosedLoop
from ehls_ros.experiments.spec import Spec
from ehls_ros.parallel import Task
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import Change, case
from ehls_ros.reproduction.paper import Cell
from ehls_ros.reproduction.results import ContinuousRun

STEP = 4e-6
"""Period of control and integration [s]; the robust rate times it is 0.35."""

DURATION = 5.0
"""Plant time [s]: complete periods of every sine except fd1, which has passed both extremes."""

POINTS = 2000
"""Number of points of the lines sliding_bound for the report."""


def tasks() -> list[Task]:
    """Return one run per FASMC II cell."""
    return [partial(against_bounds, cell) for cell in paper.CELLS if cell.controller == paper.FASMC_2]


def paper_quantities(spec: Spec) -> dict[str, float]:
    """Return e1 [MPa/mm], m0 [t] and the reaching rate [1/s] of a FASMC spec, in the law's units."""
    p = spec.controller.parameters
    plant = in_python(fasmc.paper_units)(spec.controller_rig.plant)
    e1 = 4.0 * plant.bulk_modulus / plant.total_volume * plant.piston_area
    return {"e1": e1, "m0": plant.moving_mass, "rate": reaching_rate(p.h, p.b, p.xi, e1, p.delta_f, plant.moving_mass)}


def against_bounds(cell: Cell) -> ContinuousRun:
    """Run one cell in continuous time and compare it with the bounds."""
    change = Change(
        {"control_period": STEP, "integration_step": STEP, "duration": DURATION, "controller": {"implicitness": 0.0}}
    )
    spec = case(cell, change)
    p, units = spec.controller.parameters, paper_quantities(spec)
    s_bound, e_bound = p.b / p.h, pressure_error_bound(p.k, p.g, p.h, p.b)
    loop = ClosedLoop(spec)
    column = loop.columns.status.start
    outside_s = outside_e = -1
    start_s = start_e = 0.0
    window = math.ceil(spec.cycles / POINTS)
    lines: list[np.ndarray] = []
    for block in loop.blocks():
        s = np.abs(block.record[:, column + base.S])
        e = np.abs(block.record[:, column + base.E3])
        if block.first == 0:
            start_s, start_e = float(s[0]), float(e[0])
        lines.append(np.stack([s, e]))
        for number, values, bound in ((0, s, s_bound), (1, e, e_bound)):
            beyond = np.flatnonzero(~(values <= bound))
            if beyond.size:
                last = block.first + int(beyond[-1])
                outside_s, outside_e = (last, outside_e) if number == 0 else (outside_s, last)
    s, e = np.concatenate(lines, axis=1)
    reached, converged = (outside_s + 1) * STEP, (outside_e + 1) * STEP
    reaching = reaching_time_bound(start_s, p.h, p.b, p.xi, units["e1"], p.delta_f, units["m0"])
    remains = remaining_s(p.h, p.b, p.xi, units["e1"], p.delta_f, units["m0"])
    sliding = sliding_time(start_e, e_bound, p.k, p.g, p.xi)
    sliding_bound = sliding_time(start_e, e_bound, p.k, p.g, p.xi, remains)
    after = slice(min(outside_e + 1, len(e) - 1), None)
    area = spec.controller_rig.plant.piston_area * 1e6
    edges = np.arange(0, len(s), window)
    return ContinuousRun(
        reference=cell.reference,
        disturbance=cell.disturbance,
        start_s=start_s,
        start_error_n=start_e * area,
        reached_s=reached,
        reaching_bound_s=reaching,
        sliding_s=sliding,
        sliding_bound_s=sliding_bound,
        converged_s=converged,
        paper_bound_s=reaching + sliding,
        convergence_bound_s=reaching + sliding_bound,
        largest_s=float(s[min(outside_s + 1, len(s) - 1) :].max()),
        s_bound=s_bound,
        largest_error_n=float(e[after].max()) * area,
        error_bound_n=e_bound * area,
        holds=bool(reached <= reaching + STEP and converged <= reaching + sliding_bound),
        time_s=tuple((edges * STEP).tolist()),
        s_line=tuple(np.maximum.reduceat(s, edges).tolist()),
        error_line_n=tuple((np.maximum.reduceat(e, edges) * area).tolist()),
    )
