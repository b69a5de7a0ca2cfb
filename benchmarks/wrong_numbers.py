"""Wrong numbers of a rig file: the laws on the paper's emulated rig by the defaults of a bridge, and without them.

    python -m benchmarks.wrong_numbers
    python -m benchmarks.wrong_numbers --single-rod     # on config/rig_single_rod.yaml, 6 kN

A sine of 10 kN at 0.5 Hz against the position servo, with sensors and a delay of one cycle. Each row has one wrong number or
lacks some; the error is that of the true force, the largest of the last half: median and worst over seeds of the noise.
"""

import statistics
from collections.abc import Mapping
from typing import Any, NamedTuple

from benchmarks.common import parser_of
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.real_rig import for_real_rig
from ehls_ros.experiments.spec import COMMAND_DELAY, COUPLING, Spec, load_rig, spec_from_mapping
from ehls_ros.experiments.stepped_run import stepped_run
from ehls_ros.physics.rig import Rig, rig_from_mapping, rig_to_mapping

LAWS = ("fasmc_predictive", "fasmc_output_feedback")
LOW, HIGH = 0.8, 1.2

SEEDS = 5
"""Number of seeds: where the piston breaks away, the largest error of one run in several is twice the usual."""


class Task(NamedTuple):
    """A rig and its motion.

    Attributes:
        rig: name of the rig file.
        force: amplitude of the reference [N].
        stroke: amplitude of the actuator under test [m].
    """

    rig: str
    force: float
    stroke: float


DOUBLE_ROD, SINGLE_ROD = Task("rig_paper_measured", 1e4, 0.125), Task("rig_single_rod", 6e3, 0.02)


class Case(NamedTuple):
    """A rig file.

    Attributes:
        factors: on coefficients of the plant, by name.
        known: effects that it has.
        noise: whether it has the noise of the sensors.
    """

    factors: Mapping[str, float] = {}
    known: tuple[str, ...] = (COMMAND_DELAY, COUPLING)
    noise: bool = True


CASES = {
    "right": Case(),
    **{
        f"{name} {'high' if factor > 1.0 else 'low'}": Case({name: factor})
        for name in ("bulk_modulus", "piston_area", "discharge_coefficient", "valve_bandwidth", "moving_mass")
        for factor in (LOW, HIGH)
    },
    "no delay": Case(known=(COUPLING,)),
    "no coupling": Case(known=(COMMAND_DELAY,)),
    "neither": Case(known=()),
    "neither, area low": Case({"piston_area": LOW}, ()),
    "neither, area high": Case({"piston_area": HIGH}, ()),
    "no noise of the sensors": Case(noise=False),
}


def wrong_rig(rig: Rig, case: Case) -> Rig:
    """Return a rig with the wrong coefficients; a wrong piston area is that of both chambers."""
    wrong = rig_to_mapping(rig)
    for name, factor in case.factors.items():
        places = [(wrong["plant"], name)] if name in wrong["plant"] else [(wrong["cylinder"], f"area_{side}") for side in "ab"]
        for section, key in places:
            section[key] *= factor
    return rig_from_mapping(wrong, "wrong numbers")


def experiment(law: str, case: Case, task: Task, duration: float) -> Spec:
    """Return the experiment of a law with a rig file."""
    rig = load_rig(configured(task.rig))
    wrong = wrong_rig(rig, case)
    content: dict[str, Any] = {
        "rig": rig_to_mapping(rig),
        "controller_rig": rig_to_mapping(wrong if case.noise else wrong._replace(sensors={})),
        "effects": [{"name": COMMAND_DELAY, "delay": 1e-3}],
        "known_effects": list(case.known),
        "duration": duration,
        "reference": {"name": "sine", "amplitude": task.force, "frequency": 0.5},
        "disturbance": {"name": "position_servo", "signal": {"name": "sine", "amplitude": task.stroke, "frequency": 1.0}},
        "controller": {"name": law},
    }
    return spec_from_mapping(content, "wrong numbers", configured("rig_paper").parent)


def cell(spec: Spec) -> str:
    """Return median and worst of the largest errors over the seeds."""
    seeded = (spec._replace(settings=spec.settings._replace(seed=seed)) for seed in range(SEEDS))
    errors = [stepped_run(each).largest() for each in seeded]
    return f"{statistics.median(errors):.4g} ({max(errors):.3g})"


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--duration", type=float, default=10.0, help="of each run, s (%(default)s)")
    parser.add_argument("--single-rod", action="store_true", help="on a single rod")
    options = parser.parse_args()
    duration, task = options.duration, SINGLE_ROD if options.single_rod else DOUBLE_ROD
    print(f"{'largest error in N':26}" + "".join(f"{law:>26}{'no adaptation':>22}" for law in LAWS))
    for name, case in CASES.items():
        specs = [experiment(law, case, task, duration) for law in LAWS]
        cells = [(cell(for_real_rig(spec).spec), cell(spec)) for spec in specs]
        print(f"{name:26}" + "".join(f"{real:>26}{plain:>22}" for real, plain in cells), flush=True)


if __name__ == "__main__":
    main()
