"""A campaign's wall and processor time: one process, two, and a Dask cluster of two, compared with a bare loop.

Two bare loops side by side, each with half of the runs and no start-up, are the best the machine's two processors allow.

    python -m benchmarks.campaign --repeats 3

The variants take turns, so that other work on the machine affects all alike; medians are printed. Processor time covers every
process of the campaign, including the start of Python and its imports; kernels are compiled before.
On a busy machine, judge by processor time: it is the time that two processes would take with a core each.
"""

import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import psutil
import yaml

from benchmarks.common import CONFIG, parser_of
from ehls_ros.experiments.campaign.plan import load_plan
from ehls_ros.experiments.campaign.work import run_one

CAMPAIGN = CONFIG / "campaigns" / "rig_within_ten_percent.yaml"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


class Cost(NamedTuple):
    """Cost of a variant: total [s], time between start and table [s], largest resident memory of a process [MB]."""

    wall: float
    cpu: float
    runs_wall: float
    memory: float = float("nan")


def bare(specs: list[str]) -> Cost:
    """Run the specs in this process, one after another."""
    wall, cpu = time.perf_counter(), time.process_time()
    for spec in specs:
        run_one(spec)
    wall = time.perf_counter() - wall
    return Cost(wall, time.process_time() - cpu, wall)


def side_by_side(specs: list[str]) -> Cost:
    """Run the specs in two copies of this process, half of them each."""
    start = time.perf_counter()
    with multiprocessing.get_context("fork").Pool(2) as pool:
        halves = pool.map(bare, [specs[::2], specs[1::2]], chunksize=1)
    wall = time.perf_counter() - start
    return Cost(wall, sum(half.cpu for half in halves), wall)


def campaign(file: Path, *options: str) -> Cost:
    """Run the campaign as a user does, in an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "ehls_ros.cli.main", "campaign", str(file), "--out", folder, "--json", *options]
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        output = process.stdout.read() if process.stdout is not None else ""
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
    summary = json.loads(output.splitlines()[-1])
    if summary["failed"] or summary["made"] != summary["runs"]:
        raise SystemExit(f"the campaign is incomplete: {summary}")
    return Cost(wall, usage.ru_utime + usage.ru_stime, summary["wall_s"], usage.ru_maxrss / 1024)


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[psutil.Process]]]:
    """Start a scheduler and its workers; yields the address and the workers' processes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scheduler.json")
        common = ["--scheduler-file", str(file), "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
        here = ["--host", "127.0.0.1"]
        start = [sys.executable, "-m", "dask"]
        processes = [subprocess.Popen([*start, "scheduler", "--port", "0", *here, *common])]
        try:
            deadline = time.monotonic() + 60.0
            while not file.exists() and time.monotonic() < deadline:
                time.sleep(0.05)
            worker = [*start, "worker", *common, *here, "--nthreads", "1", "--no-nanny", "--local-directory", folder]
            environment = os.environ | ONE_THREAD
            processes += [subprocess.Popen(worker, env=environment) for _ in range(workers)]
            yield json.loads(file.read_text(encoding="utf-8"))["address"], [psutil.Process(p.pid) for p in processes]
        finally:
            for process in processes[::-1]:
                process.terminate()
                process.wait(30)


def on_dask(file: Path, address: str, processes: list[psutil.Process]) -> Cost:
    """Run the campaign on a cluster and include its processes' time."""

    def used() -> float:
        return sum(sum(process.cpu_times()[:2]) for process in processes)

    before = used()
    cost = campaign(file, "--dask", address)
    return cost._replace(cpu=cost.cpu + used() - before)


def main() -> None:
    """Measure."""
    parser = parser_of(__doc__)
    parser.add_argument("--draws", type=int, default=250, help="draws at each of the four points (%(default)s)")
    parser.add_argument("--repeats", type=int, default=3, help="turns of each variant (%(default)s)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, cluster(2) as (address, processes):
        file = Path(folder, "campaign.yaml")
        content = {**load_plan(CAMPAIGN).file, "runs": options.draws}
        file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        specs = [run.spec for run in load_plan(file).runs()]
        run_one(specs[0])
        places: dict[str, Callable[[], Cost]] = {
            "bare loop": lambda: bare(specs),
            "two bare loops": lambda: side_by_side(specs),
            "--jobs 1": lambda: campaign(file, "--jobs", "1"),
            "--jobs 2": lambda: campaign(file, "--jobs", "2"),
            "--dask, 2 workers": lambda: on_dask(file, address, processes),
        }
        costs: dict[str, list[Cost]] = {name: [] for name in places}
        for _ in range(options.repeats):
            for name, measure in places.items():
                cost = measure()
                costs[name].append(cost)
                print(f"  {name:18s} wall {cost.wall:7.2f} s, runs {cost.runs_wall:7.2f} s  cpu {cost.cpu:7.2f} s", flush=True)
    show(costs, len(specs))


def show(costs: dict[str, list[Cost]], runs: int) -> None:
    """Print medians; variants are compared within each repeat."""
    one, loop = costs["--jobs 1"], costs["bare loop"]
    ceiling = statistics.median(b.wall / (2 * s.wall) for b, s in zip(loop, costs["two bare loops"], strict=True))
    print(f"\n{runs} runs, medians of {len(one)}; two bare loops side by side reach {100 * ceiling:.1f} % of twice one alone")
    headings = {"wall": 9, "runs": 9, "cpu": 9, "runs eff.": 10, "cpu eff.": 10, "cpu overhead": 15, "memory": 9}
    print(" " * 18 + "".join(f" {text:>{width}s}" for text, width in headings.items()))
    for name, taken in costs.items():
        workers = 1 if name in {"bare loop", "--jobs 1"} else 2
        wall_efficiency = statistics.median(o.runs_wall / (workers * c.runs_wall) for o, c in zip(one, taken, strict=True))
        cpu_efficiency = statistics.median(o.cpu / c.cpu for o, c in zip(one, taken, strict=True))
        overhead = statistics.median((c.cpu - b.cpu) / runs for b, c in zip(loop, taken, strict=True))
        wall, cpu, runs_wall, memory = (statistics.median(getattr(c, field) for c in taken) for field in Cost._fields)
        print(
            f"{name:18s} {wall:7.2f} s {runs_wall:7.2f} s {cpu:7.2f} s"
            f" {100 * wall_efficiency:8.1f} % {100 * cpu_efficiency:8.1f} % {1e3 * overhead:8.2f} ms/run {memory:6.0f} MB"
        )


if __name__ == "__main__":
    main()
