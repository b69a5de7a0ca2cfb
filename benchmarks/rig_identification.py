"""Accuracy of the identification of a whole rig: unknown rigs, from a first guess that is off by a factor of two everywhere.

    python -m benchmarks.rig_identification --cases 20
    python -m benchmarks.rig_identification --cases 20 --rig single_rod

Each case draws a rig, every coefficient within 30 % of the rig file's, records an experiment of the truth generator with
nothing hidden, and identifies it. The first guess has every coefficient that can be fitted at twice or half the truth;
declared coefficients (piston area, density, volume, ...) are correct.
"""

import math
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np
import yaml

from benchmarks.common import RIGS, parser_of
from ehls_ros.diagnosis.coefficients import kept
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.trajectory import Trajectory
from truth_generator import record

SPREAD = 0.3
OFF = 2.0
NORMAL_95 = 1.96
TOGETHER = {"static_force": "coulomb_force"}
"""Coefficients scaled by the factor of another, so that they do not contradict each other."""


def hidden_rig(name: str, rng: np.random.Generator) -> dict[str, Any]:
    """Draw a rig file within 30 % of one of the project's."""
    rig: dict[str, Any] = yaml.safe_load(RIGS[name].read_text(encoding="utf-8"))
    return _scaled(rig, _fixed(rig) - {"plant.viscous_damping"}, lambda: rng.uniform(1.0 - SPREAD, 1.0 + SPREAD))


def _fixed(rig: Mapping[str, Any]) -> set[str]:
    return set(kept(rig_from_mapping(rig, "rig")))


def first_guess(rig: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return a rig file in which every coefficient that can be fitted is twice or half the truth."""
    return _scaled(rig, _fixed(rig), lambda: OFF if rng.random() < 0.5 else 1.0 / OFF)


def _scaled(rig: Mapping[str, Any], fixed: set[str], factor: Any) -> dict[str, Any]:
    out: dict[str, Any] = {**rig}
    for section in ("plant", "friction", "cylinder", "valve"):
        if section not in rig:
            continue
        factors = {name: factor() for name in rig[section]}
        scaled = dict(rig[section])
        for name, value in rig[section].items():
            by = factors[TOGETHER.get(name, name)]
            if isinstance(value, float) and f"{section}.{name}" not in fixed:
                scaled[name] = value * by
            elif name == "element_stiffness":
                scaled[name] = [entry * by for entry in value]
        out[section] = scaled
    return out


def case(
    name: str, experiments: tuple[str, ...], duration: float, noise: float, without: tuple[str, ...], seed: int
) -> dict[str, Any]:
    """Record a hidden rig once, with a multiple of the sensors' noise and without some columns, and identify it."""
    rng = np.random.default_rng([seed, 16])
    truth = hidden_rig(name, rng)
    guess = first_guess(truth, rng)
    experiment = experiments[seed % len(experiments)]
    data = record(truth, {}, experiment, seed=int(rng.integers(2**31)), duration=duration, noise=noise)
    columns = {column: values for column, values in data.columns.items() if column not in without}
    began = time.perf_counter()
    found = identify_rig({experiment: Trajectory(data.time, columns)}, rig_from_mapping(guess, "guess"), seed=seed)
    wall = time.perf_counter() - began
    true = rig_from_mapping(truth, "truth")
    rows = {path: (e.value, e.std, read(true, path)) for path, e in found.estimates.items()}
    return {"seed": seed, "experiment": experiment, "rows": rows, "told": found.not_identifiable, "wall": wall}


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--rig", choices=RIGS, default="paper", help="the rig that is varied (%(default)s)")
    parser.add_argument("--cases", type=int, default=20, help="how many rigs (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first (%(default)s)")
    parser.add_argument("--duration", type=float, default=60.0, help="of a recording [s] (%(default)s)")
    parser.add_argument("--experiments", nargs="+", default=["rich", "random"], help="of the truth generator (%(default)s)")
    parser.add_argument("--noise", type=float, default=1.0, help="multiple of the sensors' noise (%(default)s)")
    parser.add_argument("--without", nargs="+", default=[], help="columns that are not recorded")
    parser.add_argument("--processes", type=int, default=1, help="cases at once (%(default)s)")
    options = parser.parse_args()
    work = partial(case, options.rig, tuple(options.experiments), options.duration, options.noise, tuple(options.without))
    runs = []
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        for run in pool.map(work, range(options.first, options.first + options.cases)):
            far = [f"{path} {(v - t) / s:+.1f}" for path, (v, s, t) in run["rows"].items() if abs(v - t) > 3.0 * s]
            print(f"{run['seed']:4d} {run['experiment']:12s}{run['wall']:6.1f} s  {', '.join(far)}", flush=True)
            runs.append(run)
    print(f"{'':34s}{'told':>6s}{'median |error|':>16s}{'rms':>12s}{'largest':>10s}{'median std':>12s}{'95 % holds':>12s}")
    held, errors = list[bool](), list[float]()
    for path in sorted({path for run in runs for path in run["rows"]}):
        value, std, true = np.array([run["rows"][path] for run in runs if path in run["rows"]]).T
        inside = np.abs(value - true) <= NORMAL_95 * std
        held += inside.tolist()
        size = np.where(true != 0.0, np.abs(true), math.nan)
        error = np.abs(value - true) / size
        errors += error[np.isfinite(error)].tolist()
        print(
            f"{path:34s}{len(value):6d}{100 * np.median(error):14.3f} %{100 * math.sqrt(np.mean(error**2)):10.2g} %"
            f"{100 * np.max(error):8.2f} %"
            f"{100 * np.median(std / size):10.3f} %{100 * np.mean(inside):10.0f} %"
        )
    print(f"{'all':34s}{len(held):6d}{100 * np.median(errors):14.3f} %{'':34s}{100 * np.mean(held):10.0f} %")


if __name__ == "__main__":
    main()
