"""Sample a finely recorded experiment as converters do, with skew, jitter and offsets (`measured`)."""

import copy
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from .experiments import TICK
from .recording import CHANNELS, Recording, sensor

Rng = np.random.Generator
FINE = 4000.0
"""Sampling rate of a recording for `measured`, 1/s; the error of linear interpolation is then below the noise."""

STEPPED = ("valve_command_m",)
"""Columns that hold their value over a control cycle."""

OFFSETS = {
    "position_m": 1.0e-5, "velocity_m_s": 2.0e-4, "load_pressure_pa": 3.0e3, "spool_m": 2.0e-6, "supply_pressure_pa": 1.0e4,
    "force_n": 8.0, "pressure_a_pa": 1.0e4, "pressure_b_pa": 1.0e4,
    "oil_temperature_k": 0.5, "disturbance_force_n": 8.0,
}  # fmt: skip
"""Largest offsets by data sheet: two to four steps of resolution or standard deviations of noise."""


@dataclass(frozen=True)
class Measurement:
    """Sampling of the channels.

    Attributes:
        skew: by column, how much earlier than its time stamp a value was taken, in samples; negative is later.
        held: columns whose converter runs on a separate clock, off by the skew: the row holds its last value.
        jitter: standard deviation of a row's sampling instant, in samples; all columns of a row move together.
        offset: by column, in the column's unit.
    """

    skew: Mapping[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    jitter: float = 0.0
    offset: Mapping[str, float] = field(default_factory=dict)


def draw_measurement(
    rng: Rng, columns: Iterable[str], *, skew: float = 0.0, jitter: float = 0.0, offset: float = 0.0
) -> Measurement:
    """Draw skews of 0 to `skew` samples, half the columns held, and offsets up to a multiple of the data sheet bound."""
    names = list(columns)
    late = {name: float(rng.uniform(0.0, skew)) for name in names} if skew != 0.0 else {}
    held = tuple(name for name in late if rng.random() < 0.5)
    off = {name: float(offset * OFFSETS[name] * rng.uniform(-1.0, 1.0)) for name in names if name in OFFSETS and offset > 0.0}
    return Measurement(late, held, jitter, off)


def measured(fine: Recording, rig: Mapping[str, Any], seed: int, how: Measurement, rate: float = 1.0 / TICK) -> Recording:
    """Sample a noise-free fine recording as a data acquisition does; time stamps are nominal.

    Args:
        fine: a recording with perfect sensors at `FINE` or more.
        rig: content of the rig file, for noise and resolution of the sensors.
        seed: seed of noise and jitter.
        how: skew, jitter and offsets.
        rate: rows per second.

    Raises:
        ValueError: the recording already has noise, or lacks a column.
    """
    if fine.truth["noise"] != 0.0:
        raise ValueError(f"a recording with noise {fine.truth['noise']}: measure one with perfect sensors")
    if unknown := {*how.skew, *how.held, *how.offset} - set(fine.columns):
        raise ValueError(f"no columns {sorted(unknown)}; there are {sorted(fine.columns)}")
    noise_of, jitter_of = (np.random.default_rng(s) for s in np.random.SeedSequence([seed, 3]).spawn(2))
    period = 1.0 / rate
    at = np.arange(math.floor(fine.time[-1] * rate + 1e-6) + 1) / rate
    taken = at + how.jitter * period * jitter_of.standard_normal(at.size)
    noise = {name: noise_of.standard_normal(at.size) for name in CHANNELS}
    columns = {}
    for name, a in fine.columns.items():
        late = how.skew.get(name, 0.0) * period
        # A converter on a separate clock samples at late, late + period and so on.
        when = np.floor((taken - late) / period + 1e-9) * period + late if name in how.held else taken - late
        columns[name] = _at(fine.time, a, when, name in STEPPED) + how.offset.get(name, 0.0)
        if name in CHANNELS:
            std, resolution = sensor(rig, name)
            columns[name] = columns[name] + std * noise[name]
            if resolution > 0.0:
                columns[name] = np.floor(columns[name] / resolution + 0.5) * resolution
    truth = copy.deepcopy(fine.truth) | {"rate": rate, "noise": 1.0, "measurement": asdict(how)}
    return Recording(at, columns, truth)


def _at(time: np.ndarray, a: np.ndarray, when: np.ndarray, stepped: bool) -> np.ndarray:
    """Return a signal at given times: the last value of a stepped one, else interpolated linearly."""
    if not stepped:
        return np.interp(when, time, a)
    return a[np.clip(np.searchsorted(time, when + 1e-9, side="right") - 1, 0, a.size - 1)]
