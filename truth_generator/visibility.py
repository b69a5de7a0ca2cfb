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

import numpy as np
import yaml

from .effects import STAGES, draw_effect, effects_of
from .recording import SENSORS, Recording, record
from .residuals import model_residuals, rms


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
    floor = {stage: [rms(a - b) for a, b in zip(spoilt[stage], left[stage], strict=True)] for stage in STAGES}
    return Background(quiet, left, floor)


def against(without: Background, rig: Mapping[str, Any], r: Recording) -> dict[str, float]:
    """Return the `visibility` of the effects in a noise-free recording against a background."""
    found = model_residuals(rig, r)
    return {
        stage: max(
            (rms(a - b) / f for a, b, f in zip(found[stage], without.left[stage], without.floor[stage], strict=True)),
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
            effect = rms(changed[stage][i] - healthy[stage][i])
            other = math.sqrt(floor**2 + sum((factor * rms(rows[stage][i])) ** 2 for factor, rows in rest))
            ratios.append(effect / other)
            if effect > other:
                total = rms(changed[stage][i] - without.left[stage][i]) ** 2
                due += (total - rms(healthy[stage][i] - without.left[stage][i]) ** 2) / floor**2
                whole += total / floor**2
        seen[stage] = max(ratios, default=0.0)
    return Prominence(seen, due / whole if whole > 0.0 else 0.0)


def raw_difference(a: Recording, b: Recording) -> tuple[float, str]:
    """Return the largest rms difference of a signal, in units of its sensor's noise and resolution, and its name."""
    found = (0.0, "")
    for name, (std, resolution) in SENSORS.items():
        if name in a.columns and name in b.columns:
            unit = np.hypot(std, resolution / np.sqrt(12.0))
            found = max(found, (rms(a.columns[name] - b.columns[name]) / float(unit), name))
    return found


def main(rig_file: str, experiment: str = "rich", draws: int = 10) -> None:
    """Print the visibility of every effect over some draws: smallest, median, largest."""
    rig = yaml.safe_load(Path(rig_file).read_text(encoding="utf-8"))
    print(f"{'effect':31s} {'stage':14s} {'seen in':14s} {'visibility: min, median, max':32s} difference of recordings")
    backgrounds = [background(rig, experiment, seed=seed) for seed in range(draws)]
    for index, (name, effect) in enumerate(effects_of(rig).items()):
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
