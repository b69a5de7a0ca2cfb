"""Recordings as rigs give them: slow, at two rates, without the spool's position, with two chamber pressures."""

import copy
import math
from collections.abc import Iterable

import numpy as np

from .degrade import without
from .recording import SENSORS, Recording

Rng = np.random.Generator


def slowed(r: Recording, rate: float = 100.0, first: float = 0.0) -> Recording:
    """Keep one row in several, as a logger without a filter does.

    Args:
        r: the recording.
        rate: rows per second; a whole fraction of the recording's.
        first: time of the first row, s, rounded down to a row.

    Raises:
        ValueError: the recording's rate is no multiple of that.
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
    """Split a recording into a table of fast columns and one of all others at a lower rate, each with its own time stamps."""
    quick = set(fast)
    if unknown := quick - set(r.columns):
        raise ValueError(f"no columns {sorted(unknown)}; there are {sorted(r.columns)}")
    rest = [name for name in r.columns if name not in quick]
    return without(r, *rest), slowed(without(r, *(name for name in r.columns if name in quick)), rate, first)


def command_only(r: Recording) -> Recording:
    """Leave out the spool's position: of the valve only its command is known."""
    return without(r, "spool_m")


def chamber_pressures(r: Recording, rng: Rng) -> Recording:
    """Give the pressures of both chambers in place of the load pressure, as of a symmetric cylinder with a matched valve.

    pA - pB is the recorded load pressure, with its faults and noise; pA + pB is the supply pressure (the tank is at zero) with
    the noise of another sensor.
    """
    out = without(r, "load_pressure_pa")
    load, supply = r.columns["load_pressure_pa"], r.columns["supply_pressure_pa"]
    both = supply + math.sqrt(2.0) * SENSORS["load_pressure_pa"][0] * rng.standard_normal(load.size) * (r.truth["noise"] > 0.0)
    out.columns |= {"pressure_a_pa": 0.5 * (both + load), "pressure_b_pa": 0.5 * (both - load)}
    out.truth["degraded"].append("two chamber pressures")
    return out
