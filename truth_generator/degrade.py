"""Corrupt recordings and rig files, to test a diagnosis with imperfect inputs."""

import copy
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from .recording import Recording

Rng = np.random.Generator


def _changed(r: Recording, what: str, time: np.ndarray | None = None) -> Recording:
    """Return a copy of the recording with the change noted in its truth."""
    truth = copy.deepcopy(r.truth)
    truth["degraded"].append(what)
    return Recording((r.time if time is None else time).copy(), {name: a.copy() for name, a in r.columns.items()}, truth)


def drop_samples(r: Recording, rng: Rng, share: float = 0.01) -> Recording:
    """Drop a fraction of the samples as complete rows."""
    keep = rng.random(r.time.size) >= share
    out = _changed(r, f"{share:.2%} of the samples lost", r.time[keep])
    out.columns = {name: a[keep] for name, a in out.columns.items()}
    return out


def add_outliers(r: Recording, rng: Rng, share: float = 0.001, columns: Iterable[str] | None = None) -> Recording:
    """Add outliers of 10 to 100 % of the range to a fraction of each column's values."""
    out = _changed(r, f"{share:.2%} outliers")
    for name in columns or list(out.columns):
        a = out.columns[name]
        hit = rng.random(a.size) < share
        size = np.ptp(a) * rng.uniform(0.1, 1.0, a.size) * rng.choice([-1.0, 1.0], a.size)
        a[hit] += size[hit]
    return out


def blank(r: Recording, rng: Rng, stretches: int = 3, length: float = 0.3, columns: Iterable[str] | None = None) -> Recording:
    """Replace intervals of a given length, s, by NaN in every column."""
    out = _changed(r, f"{stretches} stretches of NaN, {length} s each")
    n = max(int(length / np.median(np.diff(r.time))), 1)
    for name in columns or list(out.columns):
        for first in rng.integers(0, max(r.time.size - n, 1), stretches):
            out.columns[name][first : first + n] = np.nan
    return out


def shift(r: Recording, column: str, late: float) -> Recording:
    """Delay one column relative to the others by a time, s; advance it if negative."""
    out = _changed(r, f"{column} late by {late * 1e3:g} ms")
    out.columns[column] = np.interp(r.time - late, r.time, r.columns[column])
    return out


def jitter(r: Recording, rng: Rng, std: float = 1.0e-4) -> Recording:
    """Add an error of standard deviation `std`, s, to the time stamps; the samples are unchanged."""
    return _changed(r, f"time stamps off by {std * 1e3:g} ms", np.sort(r.time + std * rng.standard_normal(r.time.size)))


def without(r: Recording, *columns: str) -> Recording:
    """Drop columns."""
    out = _changed(r, f"without {', '.join(columns)}")
    for name in columns:
        del out.columns[name]
    return out


def wrong_rig(rig: Mapping[str, Any], factors: Mapping[str, float]) -> dict[str, Any]:
    """Return a rig file with parameters, such as "plant.bulk_modulus", multiplied by factors."""
    out = copy.deepcopy(dict(rig))
    for path, factor in factors.items():
        section, key = path.split(".")
        value = out[section][key]
        out[section][key] = [v * factor for v in value] if isinstance(value, list) else value * factor
    return out


def draw_wrong(rng: Rng, rig: Mapping[str, Any], spread: float = 0.1, count: int = 3) -> dict[str, float]:
    """Draw factors for `wrong_rig`: `count` parameters off by up to exp(+-spread)."""
    names = [f"plant.{key}" for key in rig["plant"] if key not in {"arm_length", "gravity", "valve_gain"}]
    names += [f"friction.{key}" for key in rig["friction"] if key not in {"model", "element_weight", "stribeck_exponent"}]
    return {name: math.exp(rng.uniform(-spread, spread)) for name in rng.choice(names, count, replace=False).tolist()}
