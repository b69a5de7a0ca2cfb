"""The study behind the default integration step.

1. Order: force error over the step, with located events and with mode changes at the ends of steps only, for the paper's
   Stribeck exponent and for 2. A Stribeck curve with |v|^0.8764 is not differentiable at v = 0. The error of a step that slips
   toward a reversal is of order h^1.8764 there, for any method, and dominates at small steps.
2. Closed loop: force of config/experiments/sine_fd2.yaml, compared with the smallest step.
3. Halving: change of the steady max error of constant and sine with fd1 and fd2 at half the step.
4. Stability: the largest step at which LuGre, whose bristle relaxes at sigma0 |v|/s(v), stays bounded at the velocity limit.
"""

from typing import NamedTuple

import numpy as np
import yaml

from benchmarks.common import ROOT, parser_of
from ehls_ros.arrays import Array
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import Spec, load_spec, spec_from_mapping, spec_to_mapping
from ehls_ros.physics.integration_step import LONGEST_STEP
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.physics.simulator import Simulator, parts_of, plant_kernel

PERIOD = 1e-3
STEPS = tuple(PERIOD / n for n in (1, 2, 3, 4, 5, 8, 10, 20, 40))
FINEST = PERIOD / 320


class Motion(NamedTuple):
    """Spool command [m] and disturbance [N] as sines: amplitude and frequency [Hz]."""

    spool: float
    spool_frequency: float
    disturbance: float
    disturbance_frequency: float


LARGE = Motion(6e-4, 1.0, 5e3, 1.0)
SMALL = Motion(1.5e-5, 2.0, 0.0, 1.0)


def rig(model: str = "gms", exponent: float | None = None) -> Rig:
    """Return the paper's rig with a given friction model and Stribeck exponent."""
    data = yaml.safe_load((ROOT / "config" / "rig_paper.yaml").read_text(encoding="utf-8"))
    data["friction"]["model"] = model
    if exponent is not None:
        data["friction"]["stribeck_exponent"] = exponent
    return rig_from_mapping(data, "rig_paper.yaml")


def open_loop(plant: Rig, motion: Motion, step: float, duration: float, located: bool = True) -> Array:
    """Return the load pressure at each cycle of an open-loop motion."""
    simulator = Simulator(plant, PERIOD, step)
    if not located:
        parts = parts_of(plant)
        parts = parts._replace(numbers={**parts.numbers, "most_events": 0})
        simulator._cycle = plant_kernel(parts).cycle  # noqa: SLF001
    pressures = []
    spool, disturbance = 2.0 * np.pi * motion.spool_frequency, 2.0 * np.pi * motion.disturbance_frequency
    for t in (np.arange(round(duration / PERIOD)) * PERIOD).tolist():
        simulator.advance(
            motion.spool * np.sin(spool * t),
            motion.disturbance * np.sin(disturbance * t + 0.7),
            motion.disturbance * disturbance * np.cos(disturbance * t + 0.7),
            0.0,
            0.0,
        )
        pressures.append(simulator.y[2])
    return np.array(pressures)


def print_orders(duration: float) -> None:
    """Print errors in force and the order observed from one step to the next."""
    print(f"1. Error in force [N] and observed order, open loop, {duration:g} s, against a step of {FINEST:g} s\n")
    for model, exponent, motion, name in (
        ("gms", None, SMALL, "gms, stick-slip, exponent 0.8764"),
        ("gms", None, LARGE, "gms, large sine, exponent 0.8764"),
        ("gms", 2.0, LARGE, "gms, large sine, exponent 2"),
        ("stribeck", None, SMALL, "stribeck, stick-slip, exponent 0.8764"),
        ("stribeck", 2.0, SMALL, "stribeck, stick-slip, exponent 2"),
        ("lugre", None, SMALL, "lugre, reversals, exponent 0.8764"),
    ):
        plant = rig(model, exponent)
        exact = open_loop(plant, motion, FINEST, duration)
        print(f"{name}\n{'step [s]':>12}{'located':>12}{'order':>7}{'not located':>14}{'order':>7}")
        previous: tuple[float, float, float] | None = None
        for step in STEPS:
            errors = [
                float(np.abs(open_loop(plant, motion, step, duration, located) - exact).max()) * plant.plant.piston_area
                for located in (True, False)
            ]
            orders = ["", ""]
            if previous is not None:
                ratio = np.log(previous[0] / step)
                orders = [f"{np.log(old / new) / ratio:.2f}" for old, new in zip(previous[1:], errors, strict=True)]
            print(f"{step:12.3g}{errors[0]:12.2e}{orders[0]:>7}{errors[1]:14.2e}{orders[1]:>7}")
            previous = step, errors[0], errors[1]
        print()


def closed_loop(spec: Spec, step: float) -> Array:
    """Return the force of an experiment at a step."""
    settings = spec.settings._replace(integration_step=step)
    return run_in_process(spec._replace(settings=settings))["force_n"]


def print_closed_loop(spec: Spec) -> None:
    """Print errors in force over a closed loop run."""
    exact = closed_loop(spec, FINEST)
    half = len(exact) // 2
    print(f"2. {spec.settings.title}: difference in force [N] to a step of {FINEST:g} s, {spec.settings.duration:g} s")
    print("   the step is limited to the control period, so 1e-3 s is the coarsest\n")
    print(f"{'step [s]':>12}{'full run':>12}{'last half':>12}")
    for step in STEPS:
        difference = np.abs(closed_loop(spec, step) - exact)
        print(f"{step:12.3g}{difference.max():12.2e}{difference[half:].max():12.2e}")
    print()


def print_halving(spec: Spec) -> None:
    """Print the steady max errors at a step and at half of it."""
    print("3. Steady max error [N] (last half) and its change at half the step\n")
    print(f"{'case':>16}" + "".join(f"{f'{step:.3g} s':>14}{'half: %':>9}" for step in STEPS[:6]))
    for reference in ({"name": "constant", "value": 1e4}, {"name": "sine", "amplitude": 1e4, "frequency": 0.5}):
        for name, signal in (("fd1", (2e3, 0.25)), ("fd2", (5e3, 1.0))):
            data = spec_to_mapping(spec)
            data["reference"] = reference
            data["disturbance"] = {"name": "force", "signal": {"name": "sine", "amplitude": signal[0], "frequency": signal[1]}}
            case = spec_from_mapping(data, "benchmark", ROOT)
            row = f"{reference['name']} {name}".rjust(16)
            for step in STEPS[:6]:
                errors = [
                    evaluate(
                        run_in_process(case._replace(settings=case.settings._replace(integration_step=chosen)))
                    ).max_error_n
                    for chosen in (step, step / 2)
                ]
                row += f"{errors[0]:14.4f}{abs(errors[1] / errors[0] - 1) * 100:9.4f}"
            print(row)
    print()


def bristle_grows(step: float, velocity: float) -> bool:
    """Return whether LuGre's bristle departs from its steady force at a constant velocity."""
    plant = rig("lugre")
    # Mass and leakage are so large that velocity and pressure stay constant.
    plant = plant._replace(plant=plant.plant._replace(moving_mass=1e15, gravity=0.0, leakage_coefficient=0.0))
    simulator = Simulator(plant, PERIOD, step)
    simulator.y[1] = velocity
    constants = simulator.constants._replace(step=step, steps=round(2.0 / step))
    simulator._cycle(0, constants, simulator.state, 0.0, np.zeros(4))  # noqa: SLF001
    force = float(simulator.y[4])
    return not abs(force - plant.friction.coulomb_force) < 1.0


def print_stability() -> None:
    """Print the largest stable step of LuGre at several velocities."""
    print("4. Largest step at which LuGre's bristle is stable; the scheme's limit is 3.307 s(v)/(sigma0 |v|)\n")
    print(f"{'velocity [m/s]':>16}{'observed [s]':>14}{'limit [s]':>12}")
    plant = rig("lugre")
    for velocity in (0.1, 0.5, 1.0, plant.limits.velocity):
        low, high = 1e-5, 2e-2
        while high / low > 1.001:
            middle = np.sqrt(low * high)
            low, high = (low, middle) if bristle_grows(middle, velocity) else (middle, high)
        limit = 3.307 * plant.friction.coulomb_force / (plant.friction.presliding_stiffness * velocity)
        print(f"{velocity:16g}{low:14.3e}{limit:12.3e}")
    print(f"\ndefault step: {LONGEST_STEP:g} s")


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--duration", type=float, default=1.0, help="plant time of the open-loop motions [s]")
    options = parser.parse_args()
    spec = load_spec(ROOT / "config" / "experiments" / "sine_fd2.yaml")
    print_orders(options.duration)
    print_closed_loop(spec)
    print_halving(spec)
    print_stability()


if __name__ == "__main__":
    main()
