"""Visibility of an effect: its signal-to-noise ratio in the residuals, independent of the method of detection.

The nominal equations are applied to each recorded signal. The noise-free residual with an effect, minus that without it, is
compared with the residual of noise alone. This serves to choose sizes. It needs noise-free signals, so it is not a method of
diagnosis. Run as a script, it prints the table of all effects.
"""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba as nb
import numpy as np
import yaml
from scipy.signal import butter, sosfiltfilt

from .effects import EFFECTS, draw_effect
from .recording import SENSORS, Recording, record

BAND = 25.0  # Hz, bandwidth of the flow and force balances
EDGE = 0.1  # s, omitted at either end
STAGES = ("force_balance", "flow", "valve", "sensors")


@nb.njit(cache=True)
def friction_along(v, dt, stiffness, weight, attraction, fc, fs, vs, exponent, lugre):
    """Return the friction force of a given motion, without the viscous part."""
    force, mode = np.zeros(stiffness.size), np.zeros(stiffness.size)
    out = np.empty(v.size)
    for j in range(v.size):
        side = 1.0 if v[j] > 0.0 else -1.0
        s = fc + (fs - fc) * np.exp(-((abs(v[j]) / vs) ** exponent))
        total = 0.0
        for i in range(force.size):
            if lugre:
                decay = np.exp(-stiffness[i] * abs(v[j]) / s * dt)
                force[i] = side * s + (force[i] - side * s) * decay
            else:
                if mode[i] * v[j] < 0.0:
                    mode[i] = 0.0
                if mode[i] == 0.0:
                    force[i] += stiffness[i] * v[j] * dt
                    if side * force[i] > weight[i] * s:
                        force[i] = side * weight[i] * s
                        mode[i] = side
                else:
                    force[i] += attraction * (side * weight[i] - force[i] / s) * dt
            total += force[i]
        out[j] = total
    return out


def model_residuals(rig: Mapping[str, Any], r: Recording) -> dict[str, list[np.ndarray]]:
    """Return the residuals of the nominal equations for a recording, by stage.

    Columns may be missing: residuals that compare them are omitted, the spool follows from the command, and the supply
    pressure is the rig file's.
    """
    plant, friction = rig["plant"], rig["friction"]
    c, step = r.columns, 1.0 / r.truth["rate"]
    low = butter(3, BAND, fs=1.0 / step, output="sos")
    edge = round(EDGE / step)

    def band(a: np.ndarray) -> np.ndarray:
        return sosfiltfilt(low, a)[edge:-edge]

    x = sosfiltfilt(low, c["position_m"])
    v = np.gradient(x, step)
    p_load, command = c["load_pressure_pa"], plant["valve_gain"] * c["valve_command_m"]
    modelled = np.empty_like(command)
    modelled[0] = c["spool_m"][0] if "spool_m" in c else command[0]
    modelled[1:] = _follow(command, np.exp(-plant["valve_bandwidth"] * step), modelled[0])
    spool = c.get("spool_m", modelled)
    supply = c.get("supply_pressure_pa", plant["supply_pressure"])
    flow = plant["discharge_coefficient"] * plant["valve_area_gradient"] * spool
    flow *= np.sqrt(np.maximum(supply - np.sign(spool) * p_load, 0.0) / plant["oil_density"])
    compressed = plant["total_volume"] / (4.0 * plant["bulk_modulus"]) * np.gradient(p_load, step)
    lugre = friction["model"] == "lugre"
    stiffness, weight = (np.asarray(friction[key], float) for key in ("element_stiffness", "element_weight"))
    if lugre:
        stiffness, weight = stiffness.sum(keepdims=True), np.ones(1)
    rub = friction_along(
        v, step, stiffness, weight, friction["attraction_rate"], friction["coulomb_force"], friction["static_force"],
        friction["stribeck_velocity"], friction["stribeck_exponent"], lugre,
    )  # fmt: skip
    force = (
        plant["piston_area"] * p_load
        - plant["moving_mass"] * (np.gradient(v, step) + plant["gravity"])
        - (plant["viscous_damping"] + friction["viscous_coefficient"]) * v
        - plant["spring_stiffness"] * x
        - rub
        - c["disturbance_force_n"]
    )
    return {
        "force_balance": [band(force)],
        "flow": [
            band(flow - plant["piston_area"] * v - plant["leakage_coefficient"] * p_load - compressed),
            *([band(supply - plant["supply_pressure"])] if "supply_pressure_pa" in c else []),
        ],
        "valve": [(spool - modelled)[edge:-edge]] if "spool_m" in c else [],
        "sensors": [
            band(c[name] - other)
            for name, other in {"force_n": plant["piston_area"] * p_load, "velocity_m_s": v}.items()
            if name in c
        ],
    }


@nb.njit(cache=True)
def _follow(command, decay, first):
    """Return the spool position by (4) at the end of each cycle of a held command."""
    out = np.empty(command.size - 1)
    at = first
    for i in range(out.size):
        at = command[i] + (at - command[i]) * decay
        out[i] = at
    return out


@dataclass
class Background:
    """Experiment without effects: its noise-free recording, its residuals, and the rms that noise adds to these."""

    recording: Recording
    left: dict[str, list[np.ndarray]]
    floor: dict[str, list[float]]


def background(
    rig: Mapping[str, Any],
    experiment: str,
    *,
    seed: int,
    duration: float = 60.0,
    disturbed: bool = True,
    given: Callable[[Recording], Recording] = lambda r: r,
) -> Background:
    """Run an experiment without effects.

    Args:
        rig: content of the rig file.
        experiment: name in `EXPERIMENTS`.
        seed: seed of the experiment and the noise.
        duration: duration, s.
        disturbed: whether a disturbance force acts.
        given: selects the available columns of a recording; all by default.
    """
    quiet, noisy = (
        given(record(rig, {}, experiment, seed=seed, duration=duration, noise=noise, disturbed=disturbed))
        for noise in (0.0, 1.0)
    )
    left, spoilt = model_residuals(rig, quiet), model_residuals(rig, noisy)
    floor = {stage: [_rms(a - b) for a, b in zip(spoilt[stage], left[stage], strict=True)] for stage in STAGES}
    return Background(quiet, left, floor)


def against(without: Background, rig: Mapping[str, Any], r: Recording) -> dict[str, float]:
    """Return the `visibility` of the effects in a noise-free recording against a background."""
    found = model_residuals(rig, r)
    return {
        stage: max(
            (_rms(a - b) / f for a, b, f in zip(found[stage], without.left[stage], without.floor[stage], strict=True)),
            default=0.0,
        )
        for stage in STAGES
    }


def visibility(
    rig: Mapping[str, Any], effects: Mapping[str, Mapping[str, Any]], experiment: str, *, seed: int, duration: float = 60.0
) -> dict[str, float]:
    """Return the rms residual due to the effects in units of that due to noise, by stage."""
    without = background(rig, experiment, seed=seed, duration=duration)
    return against(without, rig, record(rig, effects, experiment, seed=seed, duration=duration, noise=0.0))


Rows = dict[str, list[np.ndarray]]


def rows_between(a: Rows, b: Rows) -> Rows:
    """Return the differences between residuals."""
    return {stage: [x - y for x, y in zip(a[stage], b[stage], strict=True)] for stage in STAGES}


@dataclass
class Prominence:
    """Prominence of an effect on a rig that differs from the model.

    visibility: by stage, the rms residual due to the effect in units of that due to noise and all other errors.
    share: the fraction of the power unexplained by noise that is due to the effect. It covers the residuals in which the effect
    dominates, each in units of its noise.
    """

    visibility: dict[str, float]
    share: float


def prominence(without: Background, rest: Sequence[tuple[float, Rows]], healthy: Rows, changed: Rows) -> Prominence:
    """Compare an effect with all other errors.

    Args:
        without: the experiment on the model without form errors.
        rest: residuals of the other errors, each with its weight.
        healthy: the noise-free residuals without the effect.
        changed: the noise-free residuals with it.
    """
    seen: dict[str, float] = {}
    due = whole = 0.0
    for stage in STAGES:
        ratios = []
        for i, floor in enumerate(without.floor[stage]):
            effect = _rms(changed[stage][i] - healthy[stage][i])
            other = math.sqrt(floor**2 + sum((factor * _rms(rows[stage][i])) ** 2 for factor, rows in rest))
            ratios.append(effect / other)
            if effect > other:
                total = _rms(changed[stage][i] - without.left[stage][i]) ** 2
                due += (total - _rms(healthy[stage][i] - without.left[stage][i]) ** 2) / floor**2
                whole += total / floor**2
        seen[stage] = max(ratios, default=0.0)
    return Prominence(seen, due / whole if whole > 0.0 else 0.0)


def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a * a)))


def raw_difference(a: Recording, b: Recording) -> tuple[float, str]:
    """Return the largest rms difference of a signal, in units of its sensor's noise and resolution, and its name."""
    found = (0.0, "")
    for name, (std, resolution) in SENSORS.items():
        if name in a.columns and name in b.columns:
            unit = np.hypot(std, resolution / np.sqrt(12.0))
            found = max(found, (_rms(a.columns[name] - b.columns[name]) / float(unit), name))
    return found


def main(rig_file: str, experiment: str = "rich", draws: int = 10) -> None:
    """Print the visibility of every effect over some draws: smallest, median, largest."""
    rig = yaml.safe_load(Path(rig_file).read_text(encoding="utf-8"))
    print(f"{'effect':31s} {'stage':14s} {'seen in':14s} {'visibility: min, median, max':32s} difference of recordings")
    backgrounds = [background(rig, experiment, seed=seed) for seed in range(draws)]
    for index, (name, effect) in enumerate(EFFECTS.items()):
        seen, raw = [], []
        for seed, without in enumerate(backgrounds):
            hidden = {name: draw_effect(name, np.random.default_rng([seed, index]), rig)}
            with_effect = record(rig, hidden, experiment, seed=seed, noise=0.0)
            seen.append(list(against(without, rig, with_effect).values()))
            raw.append(raw_difference(with_effect, without.recording)[0])
        table = np.array(seen)
        best = table.max(axis=1)
        where = STAGES[int(np.median(table, axis=0).argmax())]
        numbers = f"{best.min():9.2f} {np.median(best):9.1f} {best.max():9.0f}"
        print(f"{name:31s} {effect.stage:14s} {where:14s} {numbers:32s} {min(raw):.1f} .. {max(raw):.0f}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:3])
