"""Variants of recordings: low rate, two rates, no spool position, two chamber pressures, single-rod cylinder, one pressure."""

import copy
import math
from collections.abc import Iterable

import numpy as np

from .degrade import without
from .recording import SENSORS, SERVO_COLUMNS, Recording

Rng = np.random.Generator
TURNING = 2.0e-5
"""Spool displacement over which the chamber pressures of a single rod change between outward and inward flow, m."""


def slowed(r: Recording, rate: float = 100.0, first: float = 0.0) -> Recording:
    """Keep every n-th row, as a logger without an anti-aliasing filter does.

    Args:
        r: the recording.
        rate: rows per second; an integer fraction of the recording's rate.
        first: time of the first row, s, rounded down to a row.

    Raises:
        ValueError: the recording's rate is not a multiple of `rate`.
    """
    ratio = r.truth["rate"] / rate
    every = round(ratio)
    if every < 1 or not math.isclose(ratio, every, rel_tol=1e-9):
        raise ValueError(f"rate {rate:g} Hz: {r.truth['rate']:g} Hz is no multiple of it")
    start = int(first * r.truth["rate"] + 1e-9)
    truth = copy.deepcopy(r.truth) | {"rate": rate}
    truth["degraded"].append(f"one row in {every}")
    return Recording(r.time[start::every].copy(), {name: a[start::every].copy() for name, a in r.columns.items()}, truth)


def two_rates(r: Recording, fast: Iterable[str], rate: float = 100.0, first: float = 0.0) -> tuple[Recording, Recording]:
    """Split a recording into a table of fast columns and one of all others at a lower rate, each with separate time stamps."""
    quick = set(fast)
    if unknown := quick - set(r.columns):
        raise ValueError(f"no columns {sorted(unknown)}; there are {sorted(r.columns)}")
    rest = [name for name in r.columns if name not in quick]
    return without(r, *rest), slowed(without(r, *(name for name in r.columns if name in quick)), rate, first)


def command_only(r: Recording) -> Recording:
    """Drop the spool position, so that only the command of the valve is known."""
    return without(r, "spool_m")


def sparse(r: Recording) -> Recording:
    """Keep the columns that any rig has: command, load pressure, position, and the external disturbances."""
    kept = {"valve_command_m", "load_pressure_pa", "position_m", "disturbance_force_n", *SERVO_COLUMNS}
    return without(r, *(name for name in r.columns if name not in kept))


def chamber_pressures(r: Recording, rng: Rng) -> Recording:
    """Replace the load pressure by both chamber pressures, for a symmetric cylinder with a matched valve.

    pA - pB is the recorded load pressure, with its faults and noise; pA + pB is the supply pressure (the tank is at zero) with
    the noise of another sensor.
    """
    out = without(r, "load_pressure_pa")
    load, supply = r.columns["load_pressure_pa"], r.columns["supply_pressure_pa"]
    both = supply + math.sqrt(2.0) * SENSORS["load_pressure_pa"][0] * rng.standard_normal(load.size) * (r.truth["noise"] > 0.0)
    out.columns |= {"pressure_a_pa": 0.5 * (both + load), "pressure_b_pa": 0.5 * (both - load)}
    out.truth["degraded"].append("two chamber pressures")
    return out


def single_rod(r: Recording, areas: tuple[float, float], rng: Rng) -> Recording:
    """Replace the load pressure by both chamber pressures, for a single rod with a matched valve.

    With areas A and B, (A pA - B pB) / mean area is the recorded load pressure, with its faults and noise. The common part of
    both pressures is that of steady flow, (ps - pA) / pB = (A / B)^2 outwards and pA / (ps - pB) = (A / B)^2 inwards, plus the
    noise of another sensor. The spool is that of the symmetric cylinder: its flow does not apply to a single rod.
    """
    a, b = areas
    out = without(r, "load_pressure_pa")
    supply, force = r.columns["supply_pressure_pa"], 0.5 * (a + b) * r.columns["load_pressure_pa"]
    drop = (a / b) ** 2
    outwards = 0.5 + 0.5 * np.tanh(r.columns["spool_m"] / TURNING)
    rod = (a * supply * (outwards + (1.0 - outwards) * drop) - force) / (a * drop + b)
    rod += SENSORS["load_pressure_pa"][0] * rng.standard_normal(rod.size) * (r.truth["noise"] > 0.0)
    out.columns |= {"pressure_a_pa": (force + b * rod) / a, "pressure_b_pa": rod}
    out.truth["degraded"].append(f"two chamber pressures of a single rod, areas {a:g} and {b:g} m²")
    return out


def one_pressure(r: Recording, areas: tuple[float, float]) -> Recording:
    """Replace both chamber pressures of a single rod by the load pressure, their force over the mean area."""
    a, b = areas
    out = without(r, "pressure_a_pa", "pressure_b_pa")
    force = a * r.columns["pressure_a_pa"] - b * r.columns["pressure_b_pa"]
    out.columns["load_pressure_pa"] = force / (0.5 * (a + b))
    out.truth["degraded"].append("one load pressure")
    return out
