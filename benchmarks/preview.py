"""Benefit of the preview of the disturbance on the emulated rig, and its cost when its servo is described wrongly.

The four experiments config/experiments/measured_*.yaml under `fasmc_predictive`: without preview, with it, and with the
servo's position gain or all of its numbers 20 % off. The error is that of the true force, the largest of the last half: its
median and largest over the seeds of the sensors' noise. `python -m benchmarks.preview --seeds 8`
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.common import MEASURED, MEASURED_EFFECTS, experiment, parser_of
from ehls_ros.control.companions.disturbance_preview import Parameters
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.stepped_run import stepped_run

OFF = (0.8, 1.2)


def previews() -> Mapping[str, list[dict[str, Any]]]:
    """Return the companions of each column by its name."""
    right = Parameters()._asdict()
    found: dict[str, list[dict[str, Any]]] = {"none": [], "right": [right]}
    for factor in OFF:
        found[f"position_gain {factor:g}"] = [{**right, "position_gain": factor * right["position_gain"]}]
        found[f"all {factor:g}"] = [{name: factor * value for name, value in right.items()}]
    return {column: [{"name": "disturbance_preview", **use} for use in uses] for column, uses in found.items()}


def with_preview(name: str, companions: list[dict[str, Any]], seed: int = 0) -> Spec:
    """Return one of the experiments under the predictive law, with these companions."""
    known = [*MEASURED_EFFECTS]
    return experiment(name, controller="fasmc_predictive", known_effects=known, companions=companions, seed=seed)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=8, help="runs of each cell")
    seeds = range(parser.parse_args().seeds)
    print(f"{'preview':24}" + "".join(f"{name.removeprefix('measured_'):>20}" for name in MEASURED))
    for column, companions in previews().items():
        text = f"{column:24}"
        for name in MEASURED:
            errors = [stepped_run(with_preview(name, companions, seed)).largest() for seed in seeds]
            text += f"{np.median(errors):12.1f}{max(errors):8.1f}"
        print(text, flush=True)


if __name__ == "__main__":
    main()
