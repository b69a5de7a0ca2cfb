"""The force error of each law against its control period, on the paper's rig and on the emulated one.

The error is that of the true force, the largest of the last half, in N; on the emulated rig its median over the seeds of the
sensors' noise. Sensors, valve and command delays stay as in the rig file. `python -m benchmarks.control_period`
"""

import numpy as np

from benchmarks.common import MEASURED_EFFECTS, experiment, parser_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.run_failure import Implausible
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.stepped_run import stepped_run

PERIODS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)
CASES = ("constant_fd1", "sine_fd1", "constant_fd2", "sine_fd2")
IDEAL = tuple((name, law) for law in ("fasmc", "fasmc_predictive") for name in CASES)
ON_RIG = tuple((f"measured_{name}", law) for law in ("fasmc_output_feedback", "fasmc_predictive") for name in CASES)


def spec_of(name: str, law: str, period: float, seed: int) -> Spec:
    """Return one of the experiments with another law and period."""
    predictive = law == "fasmc_predictive" and name.startswith("measured")
    known = {"known_effects": [*MEASURED_EFFECTS]} if predictive else {}
    return experiment(name, controller=law, control_period=period, seed=seed, **known)


def error_of(spec: Spec) -> float:
    """Return the largest true force error of the last half [N]; infinite if the force is lost."""
    if spec.controller.name == "fasmc":
        # Its sensors are ideal: readings are true values.
        try:
            return evaluate(run_in_process(spec)).max_error_n
        except Implausible:
            return np.inf
    error = stepped_run(spec).largest()
    return error if np.isfinite(error) else np.inf


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="runs of each cell of the emulated rig (default: %(default)s)")
    seeds = range(parser.parse_args().seeds)
    print(f"{'law':24}{'experiment':24}" + "".join(f"{1e3 * period:>9g} ms" for period in PERIODS))
    for name, law in (*IDEAL, *ON_RIG):
        text = f"{law:24}{name:24}"
        for period in PERIODS:
            try:
                found = [error_of(spec_of(name, law, period, seed)) for seed in (seeds if name in dict(ON_RIG) else (0,))]
                text += f"{np.median(found):12.3g}"
            except BadInput as error:
                text += f"{'refused':>12}"
                print(error)
        print(text, flush=True)


if __name__ == "__main__":
    main()
