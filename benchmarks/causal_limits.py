"""The causal limit of every cell beside what a controller reaches: the simulation study's eight and the rig's four.

The simulation's cells have perfect sensors and FASMC II, those of the rig the sensors and the delay of config/experiments/
measured_*.yaml and output feedback. The error is that of the true force, the largest of the last half: its median and largest
over the seeds of the sensors' noise. `python -m benchmarks.causal_limits --seeds 8`
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers.base import model_of
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.limits import CausalLimit
from ehls_ros.experiments.causal_limit import limit_of_run
from ehls_ros.experiments.loop import run_in_process, sampled, simulator_of
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.reproduction import paper
from ehls_ros.experiments.reproduction.cases import case
from ehls_ros.experiments.spec import Spec, load_spec
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.sensors import FORCE, POSITION, VELOCITY
from ehls_ros.report.page import limit_text

ROOT = Path(__file__).resolve().parent.parent
MEASURED = ("measured_constant_fd1", "measured_sine_fd1", "measured_constant_fd2", "measured_sine_fd2")


def true_errors(spec: Spec) -> Array:
    """Return the error of the true force in each cycle of an experiment whose controller needs no friction estimate [N]."""
    period, cycles = spec.settings.control_period, spec.cycles
    plant, reference = simulator_of(spec), sampled(spec.reference, period).rows(0, cycles)
    signal = sampled(spec.disturbance.signal, period)
    disturbing = DISTURBANCES.load(spec.disturbance.name).build(spec.disturbance.parameters, signal, spec.rig, period)
    law = Controller(spec.controller.name, spec.controller.parameters, model_of(spec.controller_rig, period))
    noise = np.random.default_rng(spec.settings.seed).standard_normal((cycles, len(SENSED)))
    errors, row, no_friction = np.empty(cycles), disturbing.first(), np.zeros(2)
    for cycle in range(cycles):
        measured = plant.measure(noise[cycle])
        errors[cycle] = plant.truth[FORCE] - reference[cycle, 0]
        command = law.step(measured, reference[cycle], no_friction)
        position, velocity = measured[POSITION], measured[VELOCITY]
        plant.advance(command, *row)
        row = disturbing.following(cycle, position, velocity)
    return errors


def line(name: str, errors: list[float], limit: CausalLimit) -> str:
    """Return a line of the table."""
    median = float(np.median(errors))
    ratio = f"{median / limit.largest:8.2f}" if limit.largest >= 0.1 else f"{'-':>8}"
    figures = (limit_text(value) for value in (limit.largest, limit.noise_share, limit.unforeseen))
    return f"{name:24}{median:10.1f}{max(errors):10.1f}{''.join(f'{figure:>12}' for figure in figures)}{ratio}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
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
        spec = load_spec(ROOT / "config" / "experiments" / f"{name}.yaml")
        found = limit_of_run(run_in_process(spec))
        if found.limit is None:
            sys.exit(found.reason)
        errors = []
        for seed in range(options.seeds):
            late = true_errors(spec._replace(settings=spec.settings._replace(seed=seed)))[spec.cycles // 2 :]
            errors.append(float(np.max(np.abs(late))))
        print(line(name, errors, found.limit), flush=True)


if __name__ == "__main__":
    main()
