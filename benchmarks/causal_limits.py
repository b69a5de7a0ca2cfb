"""Causal limit of every cell beside the error that a controller reaches: the simulation study's eight and the rig's four.

The simulation's cells have perfect sensors and FASMC II, those of the rig the sensors and the delay of config/experiments/
measured_*.yaml and output feedback. The error is that of the true force, the largest of the last half: its median and largest
over the seeds of the sensors' noise. `python -m benchmarks.causal_limits --seeds 8`
"""

import sys

import numpy as np

from benchmarks.common import MEASURED, experiment, parser_of
from ehls_ros.control.limits import CausalLimit
from ehls_ros.experiments.causal_limit import limit_of_run
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.report.page import limit_text
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import case


def line(name: str, errors: list[float], limit: CausalLimit) -> str:
    """Return a line of the table."""
    median = float(np.median(errors))
    ratio = f"{median / limit.largest:8.2f}" if limit.largest >= 0.1 else f"{'-':>8}"
    figures = (limit_text(value) for value in (limit.largest, limit.noise_share, limit.unforeseen))
    return f"{name:24}{median:10.1f}{max(errors):10.1f}{''.join(f'{figure:>12}' for figure in figures)}{ratio}"


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=8, help="runs of each cell of the rig")
    options = parser.parse_args()
    print(f"{'cell':24}{'median/N':>10}{'largest/N':>10}{'limit':>12}{'noise':>12}{'unforeseen':>12}{'ratio':>8}")
    for cell in (cell for cell in paper.CELLS if cell.controller == paper.FASMC_2):
        run = run_in_process(case(cell))
        found = limit_of_run(run)
        if found.limit is None:
            sys.exit(found.reason)
        print(line(f"{cell.reference} {cell.disturbance}", [evaluate(run).max_error_n], found.limit), flush=True)
    for name in MEASURED:
        spec = experiment(name)
        found = limit_of_run(run_in_process(spec))
        if found.limit is None:
            sys.exit(found.reason)
        runs = (spec._replace(settings=spec.settings._replace(seed=seed)) for seed in range(options.seeds))
        errors = [stepped_run(run).largest() for run in runs]
        print(line(name, errors, found.limit), flush=True)


if __name__ == "__main__":
    main()
