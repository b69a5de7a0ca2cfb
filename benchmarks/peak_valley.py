"""Benefit of `learning` with `method: peak_valley`: errors of peak, valley, mean and phase by load cycle.

usage: python -m benchmarks.peak_valley [--seeds 2] [--gain 1.0] [--method peak_valley] [--only rig]

`PI` is `sic` without compensation of the motion, 100 1/s and 100 1/s^2, against a servo at standstill. Otherwise the servo
moves by 50 mm at 0.5 Hz.

The errors are those of the piston's true force, without the load cell's noise: its largest and smallest value in a load cycle
less the reference's, its mean less the reference's, and the phase of its first harmonic relative to the reference's. They are
means of three consecutive load cycles, starting with the one in the heading, the first being 0; of the noise seed with the
largest error of peak or valley. `--gain` is the valve gain of the rig over that of the controller's rig file.
"""

import time
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import CONFIG, parser_of, print_heading, print_row
from ehls_ros.arrays import Array
from ehls_ros.experiments.loop import sampled
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.experiments.stepped_run import stepped_run

SERVO = {"name": "position_servo", "signal": {"name": "sine", "amplitude": 0.05, "frequency": 0.5}}
SIMULATION = {"rig": "rig_paper.yaml", "disturbance": SERVO}
EMULATED = {
    "rig": "rig_paper_measured.yaml",
    "effects": [{"name": "command_delay", "delay": 1e-3}],
    "known_effects": [],
    "disturbance": SERVO,
}
HELD = {"name": "position_servo", "signal": {"name": "constant", "value": 0.0}}
SIC = {"name": "sic"}
PI = {"name": "sic", "compensation": 0.0, "proportional": 100.0, "integral": 100.0}
OUTPUT_FEEDBACK = {"name": "fasmc_output_feedback"}
SINE = {"name": "sine", "amplitude": 1e4, "frequency": 0.5}
FAST = {"name": "sine", "amplitude": 3e3, "offset": 2e3, "frequency": 5.0}
TRIANGLE = {"name": "triangle", "amplitude": 1e4, "frequency": 0.5}
AFTER = (1, 3, 5, 10)


class Errors(NamedTuple):
    """Errors of one load cycle.

    Attributes:
        peak, valley, mean: [N].
        phase: [deg].
    """

    peak: float
    valley: float
    mean: float
    phase: float


CASES: dict[str, dict[str, Any]] = {
    "simulation, sic, sine": {**SIMULATION, "controller": SIC, "reference": SINE},
    "simulation, PI, sine": {**SIMULATION, "disturbance": HELD, "controller": PI, "reference": SINE},
    "simulation, PI, triangle": {**SIMULATION, "disturbance": HELD, "controller": PI, "reference": TRIANGLE},
    "rig, sic, sine": {**EMULATED, "controller": {**SIC, "proportional": 100.0}, "reference": SINE},
    "rig, sic, sine 5 Hz, servo still": {
        **EMULATED,
        "disturbance": HELD,
        "controller": {**SIC, "proportional": 100.0},
        "reference": FAST,
    },
    "rig, PI, sine": {**EMULATED, "disturbance": HELD, "controller": PI, "reference": SINE},
    "rig, PI, triangle": {**EMULATED, "disturbance": HELD, "controller": PI, "reference": TRIANGLE},
    "rig, PI, sine 1 Hz": {**EMULATED, "disturbance": HELD, "controller": PI, "reference": {**SINE, "frequency": 1.0}},
    "rig, PI, sine 2 Hz": {**EMULATED, "disturbance": HELD, "controller": PI, "reference": {**FAST, "frequency": 2.0}},
    "rig, PI, sine 5 Hz": {**EMULATED, "disturbance": HELD, "controller": PI, "reference": FAST},
    "rig, fasmc_output_feedback, sine": {
        **EMULATED,
        "known_effects": ["command_delay", "coupling_stiffness"],
        "controller": OUTPUT_FEEDBACK,
        "reference": SINE,
    },
}


def errors_of(error: Array, wanted: Array) -> Errors:
    """Return the errors of one load cycle from the true force error and the reference, shape (n,) each [N]."""
    force = wanted + error
    first = np.fft.rfft(force)[1] / np.fft.rfft(wanted)[1]
    return Errors(
        float(np.max(force) - np.max(wanted)),
        float(np.min(force) - np.min(wanted)),
        float(np.mean(error)),
        float(np.degrees(np.angle(first))),
    )


def by_load_cycle(case: dict[str, Any], seed: int, gain: float, method: str) -> Array:
    """Return the errors of each load cycle, shape (13, 4), first without learning and then with it."""
    cycles = max(AFTER) + 3
    frequency = case["reference"]["frequency"]
    data = {"title": "peaks and valleys", "duration": cycles / frequency, "seed": seed, **case}
    shifted = [] if gain == 1.0 else [{"name": "valve_gain_shift", "gain": gain}]
    data |= {"effects": [*case.get("effects", []), *shifted], "known_effects": case.get("known_effects", [])}
    found = []
    for companions in ([], [{"name": "learning", "method": method}]):
        spec = spec_from_mapping({**data, "companions": companions}, "peak_valley", CONFIG)
        whole = round(1.0 / frequency / spec.settings.control_period)
        error = stepped_run(spec).error[: cycles * whole].reshape(cycles, whole)
        wanted = sampled(spec.reference, spec.settings.control_period).rows(0, error.size)[:, 0].reshape(error.shape)
        found.append([errors_of(*one) for one in zip(error, wanted, strict=True)])
    return np.array(found)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--gain", type=float, default=1.0)
    parser.add_argument("--method", default="peak_valley")
    parser.add_argument("--only", default="", help="part of a case's name")
    args = parser.parse_args()
    began = time.monotonic()
    print("peak / valley / mean, N, and phase, degrees\n")
    print_heading("", "without, from 10", *(f"with, from {first}" for first in AFTER))
    for name, case in CASES.items():
        if args.only not in name:
            continue
        runs = [by_load_cycle(case, seed, args.gain, args.method) for seed in range(args.seeds)]
        cells = []
        for which, first in ((0, AFTER[-1]), *((1, first) for first in AFTER)):
            means = [run[which, first : first + 3].mean(axis=0) for run in runs]
            worst = max(means, key=lambda mean: float(np.max(np.abs(mean[:2]))))
            cells.append("{:.1f} / {:.1f} / {:.1f}, {:.2f}".format(*worst))
        print_row(name, *cells)
    print(f"\n{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
