"""Accuracy and speed of the plant, compared with an independent solution.

The reference, test/physics/reference_solver.py, shares no code with the package: scipy's DOP853 at a relative tolerance of
1e-12, restarted at every change of mode. The rows DOP853 show its accuracy and speed at looser tolerances.
"""

import platform
import sys
import time

import numba
import numpy as np
import scipy
import yaml

from benchmarks.common import ROOT, parser_of
from ehls_ros.arrays import Array
from ehls_ros.control.disturbances import position_servo
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.physics.simulator import Simulator, build, parts_of

sys.path.insert(0, str(ROOT / "test" / "physics"))

from reference_servo import both_turning, solve_pair
from reference_solver import Case, Constants, cases, solve

PERIOD = 1e-3
STEPS = (1e-3, 5e-4, 1e-3 / 3, 2.5e-4, 2e-4, 1e-4, 5e-5)
LOOSER = (1e-6, 1e-8, 1e-10)


def rig_of(case: Case) -> Rig:
    """Return a case's rig."""
    data = yaml.safe_load((ROOT / "config" / "rig_paper.yaml").read_text(encoding="utf-8"))
    data["friction"]["model"] = case.law
    data["effects"] = case.effects
    return rig_from_mapping(data, case.name)


def simulator_of(case: Case, step: float) -> Simulator:
    """Return the package's simulator of a case."""
    return Simulator(rig_of(case), case.period, step)


def simulate(case: Case, step: float) -> tuple[Array, float, int]:
    """Run a case.

    Returns:
        States at the cycles, time spent in the simulator [s], steps with events too dense.
    """
    simulator = simulator_of(case, step)
    states = np.empty((len(case.inputs) + 1, simulator.y.size))
    states[0] = simulator.y
    dense, spent = 0, 0.0
    for cycle, (u, force, rate) in enumerate(case.inputs.tolist(), start=1):
        before = time.perf_counter()
        dense += simulator.advance(u, force, rate, 0.0, 0.0)
        spent += time.perf_counter() - before
        states[cycle] = simulator.y
    return states, spent, dense


def errors(states: Array, reference: Array) -> Array:
    """Return the largest deviation of each state relative to the state's range."""
    compared = states[:, : reference.shape[1]]
    largest: Array = np.abs(compared - reference).max(axis=0) / np.abs(reference).max(axis=0)
    return largest


def kernel_time(case: Case, step: float, runs: int) -> float:
    """Return the median time of the compiled kernel for one step of a case, calls in batches of 1000 steps [s]."""
    simulator = simulator_of(case, step)
    for u, force, rate in case.inputs[:100].tolist():
        simulator.advance(u, force, rate, 0.0, 0.0)
    advance = compiled(build, {"advance": "cycle, constants, state"}, **parts_of(simulator.rig)._asdict()).advance
    long = simulator.constants._replace(steps=1000)
    times = []
    for _ in range(runs):
        before = time.perf_counter()
        advance(0, long, simulator.state)
        times.append((time.perf_counter() - before) / 1000)
    return float(np.median(times))


def print_servo(duration: float) -> None:
    """Print the accuracy of loader and position servo as one system, both of which reverse."""
    rig = rig_of(cases()["large sine"])
    p = position_servo.Parameters()
    loader, servo = rig.with_effects(position_servo.loader_effects(p)), position_servo.servo(p, rig, 0.0)
    inputs = both_turning(round(duration / PERIOD), PERIOD)
    reference = solve_pair(Constants(), "gms", inputs, PERIOD)
    print(f"\nloader and position servo, {reference.events} changes of mode\n{'step [s]':>12}{'largest error':>15}  dense")
    for step in STEPS:
        simulator = Simulator(loader, PERIOD, step, servo=servo)
        states, dense = [simulator.state.y.copy()], 0
        for command, wanted, rate in inputs.tolist():
            dense += simulator.advance(command, 0.0, 0.0, wanted, rate)
            states.append(simulator.state.y.copy())
        print(f"{step:12g}{errors(np.array(states), reference.y).max():15.1e}{dense:7d}")


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--duration", type=float, default=2.0, help="plant time of a case [s], at most 2")
    parser.add_argument("--runs", type=int, default=31, help="timings per median")
    options = parser.parse_args()
    print(f"{platform.machine()}, python {platform.python_version()}, numba {numba.__version__}, scipy {scipy.__version__}")
    print("ns/step and x real time of the kernel; 'from Python': called once a cycle of 1 ms; errors relative to each range")
    names = ("x", "v", "pL", "xv", "F1", "F2", "F3")
    for case in (whole.shortened(options.duration) for whole in cases().values()):
        before = time.perf_counter()
        reference = solve(case.constants, case.law, case.inputs, case.period)
        reference_time = time.perf_counter() - before
        print(f"\n{case.name} ({case.law}), {reference.events} changes of mode")
        print(
            f"{'step [s]':>12}"
            + "".join(f"{name:>9}" for name in names[: reference.y.shape[1]]).ljust(63)
            + "  ns/step  x real time  from Python  dense"
        )
        for step in STEPS:
            states, spent, dense = simulate(case, step)
            row = "".join(f"{error:9.1e}" for error in errors(states, reference.y)).ljust(63)
            nanoseconds = kernel_time(case, step, options.runs) * 1e9
            print(
                f"{step:12g}{row}{nanoseconds:9.0f}{step / nanoseconds * 1e9:13.0f}{options.duration / spent:13.0f}{dense:7d}"
            )
        for tolerance in LOOSER:
            before = time.perf_counter()
            looser = solve(case.constants, case.law, case.inputs, case.period, rtol=tolerance)
            spent = time.perf_counter() - before
            row = "".join(f"{error:9.1e}" for error in errors(looser.y, reference.y)).ljust(63)
            print(f"{f'DOP853 {tolerance:.0e}':>12}{row}{'':22}{options.duration / spent:13.1f}")
        print(f"{'DOP853 1e-12':>12}{'':85}{options.duration / reference_time:13.1f}")
    print_servo(options.duration)


if __name__ == "__main__":
    main()
