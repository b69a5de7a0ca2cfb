"""A single rod beside the double rod: force errors of the laws, robustness, and time per integration step.

The single rod is the paper's rig with areas of ratio 2 whose mean is the paper's, oil columns of 0.4 m, and edges in the ratio
of the areas: with equal edges, chamber A cavitates where a load pulls the rod out. Both have the paper's friction and load.

1. Largest and rms force error over the last half of each of the eight cells, by law.
2. The same of FASMC with each coefficient of the actual rig 20 % off.
3. Time per integration step of both cylinders, taken in turns.
"""

import argparse
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import EXPERIMENTS, RIG, in_turns, parser_of, quartiles
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.run_failure import RunFailed
from ehls_ros.experiments.spec import load_spec, spec_from_mapping, spec_to_mapping
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.physics.simulator import Simulator
from ehls_ros.recording.yaml_text import read_yaml

RATIO, HEIGHT = 2.0, 0.4
"""Ratio of the areas, and oil volume over area of each chamber at position 0 [m]."""

REFERENCES, DISTURBANCES = ("constant", "sine", "triangle", "irregular"), ("fd1", "fd2")
LAWS = ("fasmc", "sic", "fasmc_output_feedback", "fasmc_predictive")

VARIED = ("area_a", "area_b", "volume_a", "volume_b")
"""Coefficients of the cylinder that the second table varies."""

VARIED_PLANT = ("bulk_modulus", "discharge_coefficient", "leakage_coefficient", "moving_mass", "valve_bandwidth")
"""Those of the plant."""


def single_rod(**cylinder: float) -> dict[str, Any]:
    """Return the rig file of the single rod, with other keys of its cylinder."""
    data: dict[str, Any] = dict(read_yaml(RIG, "rig"))
    mean = data["plant"]["piston_area"]
    kept = {key: value for key, value in data["plant"].items() if key not in ("piston_area", "total_volume")}
    areas = {"area_a": 2.0 * mean * RATIO / (1.0 + RATIO), "area_b": 2.0 * mean / (1.0 + RATIO)}
    volumes = {key.replace("area", "volume"): HEIGHT * area for key, area in areas.items()}
    return {
        **data,
        "plant": kept,
        "cylinder": {"model": "two_chamber", **areas, **volumes, **cylinder},
        "valve": {"model": "four_edges", "gain_pb": 1.0 / RATIO, "gain_bt": 1.0 / RATIO},
    }


def errors(name: str, law: str, rig: dict[str, Any], known: dict[str, Any], duration: float) -> tuple[float, float]:
    """Return the largest and rms error of a cell [N]; NaN where the run failed.

    Args:
        name: reference and disturbance.
        law: the controller.
        rig: content of the rig file.
        known: that of the controller's rig.
        duration: of the run [s].
    """
    reference, disturbance = name.split("_")
    base = load_spec(EXPERIMENTS / f"{reference}_fd2.yaml")
    of = load_spec(EXPERIMENTS / f"constant_{disturbance}.yaml")
    mapping = {**spec_to_mapping(base), "disturbance": spec_to_mapping(of)["disturbance"]}
    mapping |= {"rig": rig, "controller_rig": known, "controller": {"name": law}, "duration": duration}
    spec = spec_from_mapping({key: value for key, value in mapping.items() if value is not None}, name, Path())
    try:
        metrics = evaluate(run_in_process(spec, check=False))
    except RunFailed:
        return float("nan"), float("nan")
    return metrics.max_error_n, metrics.rms_error_n


def print_cells(laws: list[str], duration: float) -> None:
    """Print the errors in the eight cells on both cylinders."""
    double, single = dict(read_yaml(RIG, "rig")), single_rod()
    print(f"Force error [N], largest / rms over the last half of {duration:g} s: double rod, single rod\n")
    for law in laws:
        print(f"| {law} | double rod | single rod | ratio of the largest |\n|---|---|---|---|")
        for disturbance in DISTURBANCES:
            for reference in REFERENCES:
                name = f"{reference}_{disturbance}"
                one, two = (errors(name, law, rig, rig, duration) for rig in (double, single))
                print(
                    f"| {name} | {one[0]:.1f} / {one[1]:.2f} | {two[0]:.1f} / {two[1]:.2f} | {two[0] / one[0]:.2f} |",
                    flush=True,
                )
        print()


def print_robustness(duration: float) -> None:
    """Print the errors of FASMC where a coefficient of the actual rig is 20 % off."""
    known = single_rod()
    print("FASMC on constant_fd2, a coefficient of the actual single rod 20 % lower / higher: largest error [N]\n")
    print(f"nominal: {errors('constant_fd2', 'fasmc', known, known, duration)[0]:.1f}")
    for key, rigs in _off_by(0.2):
        low, high = (errors("constant_fd2", "fasmc", rig, known, duration)[0] for rig in rigs)
        print(f"{key}: {low:.1f} / {high:.1f}", flush=True)


def _off_by(part: float) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    nominal = single_rod()
    for key in VARIED:
        yield key, [single_rod(**{key: nominal["cylinder"][key] * factor}) for factor in (1.0 - part, 1.0 + part)]
    for key in VARIED_PLANT:
        plants = [{**nominal["plant"], key: nominal["plant"][key] * factor} for factor in (1.0 - part, 1.0 + part)]
        yield key, [{**nominal, "plant": plant} for plant in plants]


def print_speed(rounds: int) -> None:
    """Print the time per integration step of both cylinders."""
    step = 2.5e-4
    rigs: dict[str, Rig] = {
        "double rod": rig_from_mapping(read_yaml(RIG, "rig"), "rig"),
        "single rod": rig_from_mapping(single_rod(), "rig"),
    }
    # Long control periods, so that the call from Python takes no part.
    period, cycles = 0.05, 100
    made = {name: Simulator(rig, period, step) for name, rig in rigs.items()}
    commands = (3e-4 * np.sin(2.0 * np.pi * 0.5 * period * np.arange(cycles))).tolist()

    def run(name: str) -> None:
        for command in commands:
            made[name].advance(command, 0.0, 0.0, 0.0, 0.0)

    taken = in_turns({name: partial(run, name) for name in made}, rounds, time.process_time)
    steps = cycles * period / step
    for name, times in taken.items():
        print(f"{name}: {quartiles(1e9 * times / steps, '.0f')} ns per step")
    single, double = taken["single rod"], taken["double rod"]
    print(f"single over double: {quartiles(single / double, '.2f')}, fastest rounds {single.min() / double.min():.2f}")


def main() -> None:
    """Print the tables."""
    parser: argparse.ArgumentParser = parser_of(__doc__)
    parser.add_argument("--laws", nargs="*", default=list(LAWS), help="laws of the first table; none: leave it out")
    parser.add_argument("--duration", type=float, default=8.0, help="of a run [s] (%(default)s)")
    parser.add_argument("--robustness", action="store_true", help="print the second table, too")
    parser.add_argument("--rounds", type=int, default=15, help="rounds of the speed measurement; 0: leave it out (%(default)s)")
    options = parser.parse_args()
    if options.laws:
        print_cells(options.laws, options.duration)
    if options.robustness:
        print_robustness(options.duration)
    if options.rounds:
        print_speed(options.rounds)


if __name__ == "__main__":
    main()
