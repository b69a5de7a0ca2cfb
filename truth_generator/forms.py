"""Form errors, which no model of the rig contains, and the condition of a healthy rig on a given day.

A form error is not an effect: it has no name that a diagnosis could report. Each kind acts in one stage and is proportional to
one field of the kernel, so that `calibration` can set its size by simulation. The part that the rig file's coefficients would
absorb is removed from its shape, because a rig file is fitted to its rig. `Day` varies between recordings of a healthy rig: the
level of its friction and the oil temperature.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from . import kernel
from .effects import STAGES
from .experiments import TICK

Rng = np.random.Generator
Fields = dict[str, float | tuple[float, ...]]


class Signals(NamedTuple):
    """Noise-free run of the model at the control rate, to find the part of a form error that rig file coefficients absorb."""

    speed: np.ndarray
    pressure: np.ndarray
    force: np.ndarray
    command: np.ndarray
    spool: np.ndarray


class Kind(NamedTuple):
    """Kind of form error.

    stage, row: the residual of `residuals.model_residuals` that shows it. amplitude: the kernel field it is proportional to.
    first: initial guess of that field. most: the largest value that a rig could have. shape: draws the other fields.
    rods: the numbers of rods of the cylinders that can have it.
    """

    stage: str
    row: int
    amplitude: str
    first: float
    most: float
    shape: Callable[[Rng, Signals], Fields]
    rods: tuple[int, ...] = (1, 2)


def _log(rng: Rng, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _phase(rng: Rng) -> float:
    return float(rng.uniform(0.0, 2.0 * math.pi))


def _of(shape: np.ndarray, base: np.ndarray) -> float:
    """Return the least-squares coefficient of a term in a shape."""
    return float(np.sum(shape * base) / max(float(np.sum(base * base)), 1e-300))


def _wave(a: np.ndarray, turns: float, at: float, phase: float) -> np.ndarray:
    return np.sin(turns * np.log1p(np.abs(a) / at) + phase)


def _warmth(rng: Rng, s: Signals) -> Fields:
    return {"warm_rate": 2.0 * math.pi / rng.uniform(20.0, 60.0), "warm_phase": _phase(rng)}


def _over_speed(rng: Rng, s: Signals) -> Fields:
    turns, at, phase = rng.uniform(1.5, 3.0), _log(rng, 1e-3, 1e-2), _phase(rng)
    side = np.tanh(s.speed / 2e-3)
    coulomb, viscous = np.linalg.lstsq(np.stack([side, s.speed], 1), side * _wave(s.speed, turns, at, phase), rcond=None)[0]
    return {
        "speed_wave_turns": turns, "speed_wave_at": at, "speed_wave_phase": phase,
        "speed_wave_mean": float(coulomb), "speed_wave_slope": float(viscous),
    }  # fmt: skip


def _over_stroke(rng: Rng, s: Signals) -> Fields:
    share = rng.uniform(0.5, 1.0, kernel.N_WAVES)
    shared = rng.uniform(0.0, 2.0 * math.pi, kernel.N_WAVES)
    back = shared + rng.uniform(-1.5, 1.5, kernel.N_WAVES)
    return {
        "stroke_length": tuple(np.exp(rng.uniform(math.log(8e-3), math.log(6e-2), kernel.N_WAVES)).tolist()),
        "stroke_share": tuple((share / np.linalg.norm(share)).tolist()),
        "stroke_phase": (*shared.tolist(), *back.tolist()),
    }


def _memory(rng: Rng, s: Signals) -> Fields:
    time, speed = _log(rng, 0.02, 0.1), _log(rng, 0.01, 0.05)
    decay = math.exp(-TICK / time)
    remembered = lfilter([1.0 - decay], [1.0, -decay], s.speed)
    shape = np.tanh(np.abs(remembered) / speed) - np.tanh(np.abs(s.speed) / speed)
    inertia = _of(shape * np.tanh(s.speed / 2e-3), np.gradient(s.speed, TICK))
    return {"memory_time": time, "memory_speed": speed, "memory_mass": -inertia}


def _over_opening(rng: Rng, s: Signals) -> Fields:
    turns, at, phase = rng.uniform(1.5, 3.0), _log(rng, 3e-6, 3e-5), _phase(rng)
    mean = _of(s.spool * _wave(s.spool, turns, at, phase), s.spool)
    return {"flow_wave_turns": turns, "flow_wave_at": at, "flow_wave_phase": phase, "flow_wave_mean": mean}


def _over_edges(rng: Rng, s: Signals) -> Fields:
    turns, at, phase, shift = rng.uniform(1.5, 3.0), _log(rng, 3e-6, 3e-5), _phase(rng), rng.uniform(-1.5, 1.5)
    mean, mean_b = (_of(s.spool * _wave(s.spool, turns, at, phase + other), s.spool) for other in (0.0, shift))
    return {
        "flow_wave_turns": turns, "flow_wave_at": at, "flow_wave_phase": phase, "flow_wave_shift": shift,
        "flow_wave_mean": mean, "flow_wave_mean_b": mean_b,
    }  # fmt: skip


def _mount(rng: Rng, s: Signals) -> Fields:
    time, pressure = _log(rng, 3e-3, 2e-2), _log(rng, 4e5, 2e6)
    decay = math.exp(-TICK / time)
    pushed = pressure * np.arcsinh(s.pressure / pressure)
    given = pushed[0] + lfilter([1.0 - decay], [1.0, -decay], pushed - pushed[0])
    mean = _of(np.gradient(given, TICK), np.gradient(s.pressure, TICK))
    return {"mount_time": time, "mount_pressure": pressure, "mount_mean": mean}


def _over_command(rng: Rng, s: Signals) -> Fields:
    turns, at, phase, side = rng.uniform(1.5, 3.0), _log(rng, 3e-6, 3e-5), _phase(rng), rng.uniform(-1.5, 1.5)
    to, fro = np.maximum(s.command, 0.0), np.minimum(s.command, 0.0)
    return {
        "spool_wave_turns": turns, "spool_wave_at": at, "spool_wave_phase": phase, "spool_wave_side": side,
        "spool_wave_mean_pos": _of(to * _wave(to, turns, at, phase + side), to),
        "spool_wave_mean_neg": _of(fro * _wave(fro, turns, at, phase), fro),
    }  # fmt: skip


def _pace(rng: Rng, s: Signals) -> Fields:
    at = _log(rng, 3e-6, 3e-5)
    miss = s.command - s.spool
    return {"spool_pace_at": at, "spool_pace_mean": _of(miss * (miss / at) ** 2 / (1.0 + (miss / at) ** 2), miss)}


def _bow(rng: Rng, s: Signals) -> Fields:
    scale = rng.uniform(4e3, 8e3)
    square = (s.force / scale) ** 2
    return {"cell_scale": scale, "cell_bow_mean": _of(s.force * square / (1.0 + square), s.force)}


def _cell_play(rng: Rng, s: Signals) -> Fields:
    half = _log(rng, 100.0, 800.0)
    return {"cell_play_width": half, "cell_play_mean": _of(kernel.play_along(s.force, half), s.force)}


KINDS: dict[str, Kind] = {
    # force balance
    "friction_over_speed": Kind("force_balance", 0, "speed_wave", 30.0, 300.0, _over_speed),
    "friction_over_stroke": Kind("force_balance", 0, "stroke_wave", 30.0, 400.0, _over_stroke),
    "friction_memory": Kind("force_balance", 0, "memory", 100.0, 1.5e3, _memory),
    "viscosity_drift": Kind("force_balance", 0, "warm_viscous", 0.02, 0.5, _warmth),
    # flow
    "flow_over_opening": Kind("flow", 0, "flow_wave", 0.01, 0.2, _over_opening, (2,)),
    "flow_over_edge_openings": Kind("flow", 0, "flow_wave", 0.01, 0.2, _over_edges, (1,)),
    "flow_over_pressure_drop": Kind("flow", 0, "flow_exponent", 0.01, 0.3, lambda rng, s: {}),
    "flow_drift": Kind("flow", 0, "warm_flow", 0.01, 0.2, _warmth),
    "soft_mount": Kind("flow", 0, "mount", 1e-13, 4e-13, _mount, (2,)),
    # valve
    "spool_over_command": Kind("valve", 0, "spool_wave", 0.01, 0.2, _over_command),
    "spool_pace": Kind("valve", 0, "spool_pace", 0.1, 0.5, _pace),
    "spool_drift": Kind("valve", 0, "warm_valve", 0.01, 0.2, _warmth),
    # sensors
    "cell_bow": Kind("sensors", 0, "cell_bow", 0.01, 0.5, _bow),
    "cell_hysteresis": Kind("sensors", 0, "cell_play", 0.05, 1.0, _cell_play),
    "cell_sees_speed": Kind(
        "sensors", 0, "cell_per_speed", 300.0, 1e4, lambda rng, s: {"cell_per_speed_mean": _of(s.speed, s.force)}
    ),
    "speed_sensor_sees_pressure": Kind(
        "sensors", 1, "speed_per_pressure", 1e-9, 1e-7, lambda rng, s: {"speed_per_pressure_mean": _of(s.pressure, s.speed)}
    ),
}
PER_STAGE = 2  # kinds per stage of a rig
SHARED = ("warm_rate", "warm_phase")  # one temperature for all stages
SMALLEST, LARGEST = 0.002, 0.05


@dataclass(frozen=True)
class FormErrors:
    """Form errors of one rig.

    fields: the kernel's fields. kinds: by stage. sizes: by stage, rms of the residual they cause in the calibration experiment,
    as a fraction of the rms of the stage's largest term. No fields means no form errors.
    """

    fields: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)
    kinds: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)

    def apply(self, p: np.ndarray) -> None:
        """Write the fields into the kernel's record."""
        for name, value in self.fields.items():
            p[name] = value

    def only(self, kinds: tuple[str, ...]) -> "FormErrors":
        """Return the form errors of the given kinds only."""
        off = {KINDS[kind].amplitude: 0.0 for kinds_of in self.kinds.values() for kind in kinds_of if kind not in kinds}
        return replace(self, fields={**self.fields, **off})

    def scaled(self, factors: Mapping[str, float]) -> "FormErrors":
        """Return the form errors with their kinds multiplied by factors."""
        amplitudes = {KINDS[kind].amplitude: factor for kind, factor in factors.items()}
        return replace(self, fields={**self.fields, **{name: self.fields[name] * f for name, f in amplitudes.items()}})

    def shrunk(self, stage: str, factor: float) -> "FormErrors":
        """Return the form errors with those of one stage reduced."""
        smaller = self.scaled(dict.fromkeys(self.kinds[stage], factor))
        return replace(smaller, sizes={**self.sizes, stage: self.sizes[stage] * factor})


def draw_shapes(rng: Rng, signals: Signals, smallest: float = SMALLEST, largest: float = LARGEST, rods: int = 2) -> FormErrors:
    """Draw kinds and shapes with initial sizes, and the target sizes for `calibration`."""
    fields: Fields = {}
    kinds, sizes = {}, {}
    for stage in STAGES:
        names = [name for name, kind in KINDS.items() if kind.stage == stage and rods in kind.rods]
        kinds[stage] = tuple(str(name) for name in rng.choice(names, PER_STAGE, replace=False))
        sizes[stage] = _log(rng, smallest, largest)
        for name in kinds[stage]:
            kind = KINDS[name]
            shape = kind.shape(rng, signals)
            fields |= {key: value for key, value in shape.items() if key not in SHARED or key not in fields}
            fields[kind.amplitude] = kind.first * (1.0 if rng.random() < 0.5 else -1.0)
    if "mount" in fields:
        fields["mount"] = abs(fields["mount"])  # a compliance is never negative
    return FormErrors(fields, kinds, sizes)


@dataclass(frozen=True)
class Day:
    """Condition of a healthy rig: factors of friction's level and viscous part, and the rise of the oil temperature, K."""

    level: float = 1.0
    viscous: float = 1.0
    warmer: float = 0.0

    def apply(self, p: np.ndarray) -> None:
        """Write the condition into the kernel's record."""
        p["fc"], p["fs"] = p["fc"] * self.level, p["fs"] * self.level
        p["viscous"] = p["viscous"] * self.viscous
        p["temperature_offset"] = p["temperature_offset"] + self.warmer


def draw_day(rng: Rng, spread: float = 0.02) -> Day:
    """Draw a condition: friction level within a `spread`, and an oil temperature offset that changes viscosity by 1 %/K.

    Args:
        rng: random number generator.
        spread: standard deviation of the level, and of the viscous part due to the oil's temperature.
    """
    warmer = float(100.0 * spread * rng.standard_normal())
    return Day(float(math.exp(spread * rng.standard_normal())), math.exp(-0.01 * warmer), warmer)
