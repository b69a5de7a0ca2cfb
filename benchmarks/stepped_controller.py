"""Time of a call of `ehls_ros.controller` from Python, beside a PI law of a few lines; medians over interleaved runs.

python -m benchmarks.stepped_controller
"""

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

import ehls_ros as ehls
from benchmarks.common import parser_of

RIG = "rig_paper_measured"

LAWS = ("fasmc", "sic", "fasmc_output_feedback", "fasmc_predictive")

RUNS, CALLS = 7, 1000
"""Number of interleaved runs, and of calls in each, the second half of which counts."""

WANTED = (1e3, 0.0, 0.0)
"""Reference with its derivatives."""

Law = Callable[[Mapping[str, float], tuple[float, float, float]], float]


def pi_law() -> Law:
    """Return a PI law."""
    total = [0.0]

    def law(measured: Mapping[str, float], wanted: tuple[float, float, float]) -> float:
        error = wanted[0] - measured["force"]
        total[0] += 5e-10 * error
        return 5e-8 * error + total[0]

    return law


def timed(law: Law, plant: Any) -> list[float]:
    """Return the times of a run's calls [s]."""
    times, measured = list[float](), plant.measured
    for _ in range(CALLS):
        begin = time.perf_counter()
        command = law(measured, WANTED)
        times.append(time.perf_counter() - begin)
        measured = plant.step(command)
    return times[CALLS // 2 :]


def main() -> None:
    """Print the table."""
    parser_of(__doc__).parse_args()
    laws: dict[str, Law] = {"PI in Python": pi_law(), **{name: ehls.controller(RIG, name).step for name in LAWS}}
    times: dict[str, list[list[float]]] = {name: [] for name in laws}
    for _ in range(RUNS):
        for name, law in laws.items():
            times[name].append(timed(law, ehls.plant(RIG)))
    peer = statistics.median(map(statistics.median, times["PI in Python"]))
    print(f"{'':24}{'median':>10}{'99 % of calls':>16}{'over PI':>10}")
    for name, runs in times.items():
        median = statistics.median(map(statistics.median, runs))
        late = statistics.median(sorted(run)[round(0.99 * len(run))] for run in runs)
        print(f"{name:24}{1e6 * median:7.1f} us{1e6 * late:13.1f} us{median / peer:10.0f}")


if __name__ == "__main__":
    main()
