"""Latency and missed cycles of the graph on a rig behind UDP, compared with an empty rclpy echo at the same rate.

usage: python -m benchmarks.bridge_timing [--seconds 60] [--rounds 1] [--controller fasmc_output_feedback]
                                          [--period 1e-3] [--monitor | --compose [--only composed]]

Each node is a process, over Fast DDS; the rig is `ehls rig-emulator` on its own clock. A round is echo, graph, echo, so that
both see the same state of the machine. The echo is the round trip of one small, reliable message per control period between two
processes with rclpy's events executor, at the nodes' realtime priority.

With --monitor, each round runs the graph twice, with and without `monitor_node`, in alternating order; the last line shows the
cost of the monitor itself.

With --compose, each round runs the graph twice, with each node in a process and with those of the cycle in one, in alternating
order, or in one of these ways only. The response times are then the plant's: from snapshot to command taken.
"""

import argparse
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

from benchmarks.common import ROOT, parser_of
from benchmarks.graph_timing import answer_echoes, percentiles
from benchmarks.processes import APART, COMPOSED, PARTS, WAYS, Meter, Told, told_by_plant
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import load_spec
from ehls_ros.hardware.realtime import claim, exact_wake_ups
from ehls_ros.nodes.graph import REALTIME_PRIORITY, Plant, graph_environment, node_processes, run_graph
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.trajectory import Trajectory

ITSELF = (sys.executable, "-m", "benchmarks.bridge_timing")

PERIOD = 1e-3
ECHO_SECONDS = 10.0
EMULATOR = "main"
"""Module run by the emulated rig's process."""

SPEC = config_folder() / "experiments" / "measured_sine_fd1.yaml"


def be_asker(period: float = PERIOD) -> None:
    """Print a line when it begins, one when it ends, and one with the round trips of one message per period [s]."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("asker")
    publisher = node.create_publisher(Float64, "there", 10)
    trips: list[float] = []

    def back(message: Float64) -> None:
        trips.append(time.perf_counter() - message.data)

    node.create_subscription(Float64, "back", back, 10)
    executor = EventsExecutor()
    executor.add_node(node)
    while publisher.get_subscription_count() == 0 or node.count_publishers("back") == 0:
        executor.spin_once(timeout_sec=0.1)
    exact_wake_ups()
    claim(REALTIME_PRIORITY)
    start = time.perf_counter() + 0.5
    print("begin", flush=True)
    for cycle in range(round(ECHO_SECONDS / period)):
        deadline = start + cycle * period
        while (remaining := deadline - time.perf_counter()) > 0.0:
            executor.spin_once(timeout_sec=remaining)
        publisher.publish(Float64(data=time.perf_counter()))
    executor.spin_once(timeout_sec=0.1)
    print("end", flush=True)
    print(*trips[100:], flush=True)
    # Stay alive long enough for the parent process to measure the cost of this one.
    time.sleep(0.5)


def echo(period: float) -> np.ndarray:
    """Return the round trips of an empty echo between two processes, one per period [s]."""
    environment = graph_environment()
    answering = subprocess.Popen([*ITSELF, "--be", "echo"], cwd=ROOT, env=environment)
    asker = [*ITSELF, "--be", "asker", "--period", str(period)]
    asking = subprocess.run(asker, cwd=ROOT, env=environment, check=True, capture_output=True, text=True)
    answering.send_signal(signal.SIGINT)
    answering.wait(10)
    return np.array([float(trip) for trip in asking.stdout.splitlines()[-1].split()])


class Cost(NamedTuple):
    """Cost of a process.

    Attributes:
        share: of a processor.
        memory: resident at the end [MiB].
    """

    share: float
    memory: float


def graph(
    options: argparse.Namespace, watched: bool = False, compose: bool = False
) -> tuple[Trajectory, Cost | None, Told, float]:
    """Run the graph on the emulated rig.

    Returns:
        Its recording, the cost of the monitor if there was one, the plant's last report, and the processor time of a cycle,
        over all processes but the emulator [s].
    """
    spec = load_spec(SPEC)
    spec = spec._replace(
        settings=spec.settings._replace(duration=options.seconds, control_period=options.period),
        controller=spec.controller._replace(name=options.controller),
    )
    with tempfile.TemporaryDirectory() as folder:
        run_folder = RunFolder.create(Path(folder) / "run", "bridge", overwrite=True)
        run_folder.write_spec(spec)
        with _emulator(run_folder.spec), _monitor(run_folder) if watched else nullcontext() as process:
            meter = Meter()
            wall = run_graph(spec, run_folder, "realtime", "mcap", meter, Plant("bridge"), compose=compose)
            cost = None if process is None else _cost(process.pid)
        per_cycle = sum(taken for name, taken in meter.per_cycle(spec.cycles / wall).items() if name != EMULATOR)
        return read_bag(run_folder.bag), cost, told_by_plant(run_folder.bag), per_cycle


@contextmanager
def _emulator(spec: Path) -> Iterator[None]:
    """Run the emulated rig of an experiment."""
    emulator = subprocess.Popen(
        [sys.executable, "-m", "ehls_ros.cli.main", "rig-emulator", "--spec", str(spec)], stdout=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        emulator.send_signal(signal.SIGINT)
        emulator.wait(20)


@contextmanager
def _monitor(folder: RunFolder) -> Iterator[subprocess.Popen[bytes]]:
    """Run a monitor beside the graph that comes up."""
    environment = graph_environment()
    os.environ["ROS_DOMAIN_ID"] = environment["ROS_DOMAIN_ID"]
    beside = folder.path.parent
    own = {"monitor_node": {"spec": str(folder.spec), "folder": str(beside / "monitor"), "learning_time": 30.0}}
    with node_processes(["monitor_node"], own, beside, environment) as [running]:
        yield running.process


def _cost(process: int) -> Cost:
    """Return the cost of a process since it began to wait for the rig."""
    stat = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    ticks = os.sysconf("SC_CLK_TCK")
    lived = float(Path("/proc/uptime").read_text(encoding="utf-8").split()[0]) - float(stat[19]) / ticks
    status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    memory = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
    return Cost((float(stat[11]) + float(stat[12])) / ticks / lived, float(memory) / 1024.0)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each run of the graph")
    parser.add_argument("--rounds", type=int, default=1, help="rounds of echo, graph, echo")
    parser.add_argument("--controller", default="fasmc_output_feedback", help="control law")
    parser.add_argument("--monitor", action="store_true", help="run each round with and without monitor_node")
    parser.add_argument(
        "--compose", action="store_true", help="run each round with the nodes apart and with the cycle in one process"
    )
    parser.add_argument("--only", choices=WAYS, help="with --compose, run in this way only")
    parser.add_argument("--period", type=float, default=PERIOD, help="control period [s]")
    parser.add_argument("--be", choices=("echo", "asker"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.be:
        answer_echoes(REALTIME_PRIORITY) if options.be == "echo" else be_asker(options.period)
        sys.stdout.flush()
        os._exit(0)
    print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    print("                                     p50      p99    p99.9      max  [us]")
    for number in range(options.rounds):
        before = echo(options.period)
        if options.compose:
            composed(options, number, before)
            continue
        kinds = [False, True] if options.monitor else [False]
        runs = [(watched, *graph(options, watched)) for watched in kinds[:: (-1) ** number]]
        floor = np.concatenate([before, echo(options.period)])
        for watched, trajectory, cost, _, _ in sorted(runs, key=lambda run: run[0]):
            tell(f"{number + 1} snapshot to command" + (", monitored" if watched else ""), trajectory, floor)
            if cost is not None:
                print(
                    f"  the monitor took {100 * cost.share:.1f} % of a processor, its start included, and {cost.memory:.0f} MiB"
                )
        print(f"  empty rclpy echo, round trip      {percentiles(floor)}")


def composed(options: argparse.Namespace, number: int, before: np.ndarray) -> None:
    """Run the graph apart and composed, and print the plant's response times beside the echo's round trips [s]."""
    order = [options.only] if options.only else WAYS[:: (-1) ** number]
    runs = {way: graph(options, compose=way == COMPOSED) for way in order}
    floor = np.concatenate([before, echo(options.period)])
    for way, (trajectory, _, told, cost) in sorted(runs.items()):
        what = f"{number + 1} {way}"
        print(f"{what:34s}{''.join(f'{1e6 * told.response[part]:9.0f}' for part in PARTS)}")
        lost = int(np.sum(~np.isfinite(trajectory["force_n"])))
        print(
            f"  {told.missed} missed of {len(trajectory)} cycles, {lost} lost in the bag, processor {1e6 * cost:.0f} us a cycle"
        )
    if not options.only:
        print(f"  ratio of processor time {runs[COMPOSED][3] / runs[APART][3]:.2f}")
    print(f"  empty rclpy echo, round trip      {percentiles(floor)}")


def tell(what: str, trajectory: Trajectory, floor: np.ndarray) -> None:
    """Print the latency of a run beside the echo's round trips [s]."""
    metrics = evaluate(trajectory)
    response = trajectory["response_s"]
    answered = response[np.isfinite(response)]
    lost = int(np.sum(~np.isfinite(trajectory["force_n"])))
    print(f"{what:34s}{percentiles(answered)}")
    ratios = np.percentile(answered, [50, 99]) / np.percentile(floor, [50, 99])
    print(f"  ratio {ratios[0]:.2f} at p50, {ratios[1]:.2f} at p99; {metrics.missed_cycles} of {metrics.cycles} cycles")
    print(f"  unanswered ({100 * metrics.missed_cycles / metrics.cycles:.2f} %), {lost} snapshots lost in the bag,")
    print(f"  largest error in the last half {metrics.max_error_n:.0f} N")


if __name__ == "__main__":
    main()
