"""Speed of the node graph: lockstep cycles per second and realtime latency, compared with an empty rclpy echo.

usage: python -m benchmarks.graph_timing [--lockstep-seconds 10] [--realtime-seconds 30] [--rounds 5]
                                         [--compose [--only composed]] [--period 1e-3]

Each node is a process, over Fast DDS on this host. The echo is the lower bound: the round trip of one small, reliable message
between two processes with rclpy's events executor. It has two hops, a cycle has three.

With --compose, each round has a lockstep run and a realtime run with each node in a process and with those of the cycle in one,
in alternating order, and an echo at one message per period. The table has medians and quartiles, and ratios within a round.
With --only, all runs use one of these ways. A cycle is missed if it has no answer, and late if it ended more than a period
late. Response times are the plant's: from snapshot to command taken. Processor time is that of all processes and threads.
"""

import argparse
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

from benchmarks.common import ROOT, parser_of, quartiles
from benchmarks.processes import APART, COMPOSED, PARTS, WAYS, Meter, Told, processor_time, told_by_plant
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import Spec, load_spec
from ehls_ros.hardware.realtime import claim, exact_wake_ups
from ehls_ros.nodes.graph import graph_environment, run_graph
from ehls_ros.nodes.graph_nodes import LOCKSTEP, TIMINGS
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.trajectory import Trajectory

ITSELF = (sys.executable, "-m", "benchmarks.graph_timing")

ECHOES = 5000


class Run(NamedTuple):
    """One run of the graph.

    Attributes:
        rate: cycles per second of wall time.
        cost: processor time of a cycle, over all processes [s].
        told: the plant's last diagnostics.
        lost: snapshots that are not in the bag.
    """

    rate: float
    cost: float
    told: Told
    lost: int


def measured_run(spec: Spec, timing: str, *, compose: bool) -> Run:
    """Run the graph once, recorded."""
    meter = Meter()
    with tempfile.TemporaryDirectory() as folder:
        run_folder = RunFolder.create(Path(folder) / "run", "benchmark", overwrite=True)
        run_folder.write_spec(spec)
        wall = run_graph(spec, run_folder, timing, "mcap", meter, compose=compose)
        trajectory = read_bag(run_folder.bag)
        rate = spec.cycles / wall
        lost = int(np.sum(~np.isfinite(trajectory["force_n"]))) + spec.cycles - len(trajectory)
        return Run(rate, sum(meter.per_cycle(rate).values()), told_by_plant(run_folder.bag), lost)


def run(spec: Spec, timing: str) -> tuple[Trajectory, float]:
    """Run the graph once and return its recording and the wall time of its cycles [s]."""
    with tempfile.TemporaryDirectory() as folder:
        run_folder = RunFolder.create(Path(folder) / "run", "benchmark", overwrite=True)
        run_folder.write_spec(spec)
        wall = run_graph(spec, run_folder, timing, "mcap")
        return read_bag(run_folder.bag), wall


def percentiles(seconds: np.ndarray) -> str:
    """Return p50, p99, p99.9 and the largest in us, right-aligned."""
    return "".join(f"{value * 1e6:9.0f}" for value in np.percentile(seconds, [50, 99, 99.9, 100]))


def answer_echoes(priority: int = 0) -> None:
    """Echo every message until SIGINT, at a realtime priority if given."""
    stopping = [False]
    signal.signal(signal.SIGINT, lambda *_: stopping.__setitem__(0, True))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("echo")
    publisher = node.create_publisher(Float64, "back", 10)
    node.create_subscription(Float64, "there", publisher.publish, 10)
    executor = EventsExecutor()
    executor.add_node(node)
    if priority:
        exact_wake_ups()
        claim(priority)
    while not stopping[0]:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


def echo_round_trips() -> np.ndarray:
    """Return the round trips of an empty echo between two processes [s]."""
    os.environ.update(graph_environment())
    process = subprocess.Popen([*ITSELF, "--echo"], cwd=ROOT, env=os.environ)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("asker")
    times: list[float] = []
    sent = [0.0]
    publisher = node.create_publisher(Float64, "there", 10)

    def back(message: Float64) -> None:
        times.append(time.perf_counter() - sent[0])
        sent[0] = time.perf_counter()
        publisher.publish(message)

    node.create_subscription(Float64, "back", back, 10)
    executor = EventsExecutor()
    executor.add_node(node)
    while publisher.get_subscription_count() == 0 or node.count_publishers("back") == 0:
        executor.spin_once(timeout_sec=0.1)
    time.sleep(0.5)
    sent[0] = time.perf_counter()
    publisher.publish(Float64(data=1.0))
    while len(times) < ECHOES:
        executor.spin_once(timeout_sec=0.1)
    process.send_signal(signal.SIGINT)
    process.wait(10)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    return np.array(times[100:])


def paced_echo(period: float) -> tuple[np.ndarray, float]:
    """Return the round trips of an empty echo, one per period [s], and the processor time of a round trip [s]."""
    environment = graph_environment()
    echo = [sys.executable, "-m", "benchmarks.bridge_timing", "--period", str(period), "--be"]
    answering = subprocess.Popen([*echo, "echo"], cwd=ROOT, env=environment)
    asking = subprocess.Popen(
        [*echo, "asker"],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert asking.stdout is not None  # noqa: S101
    asking.stdout.readline()
    before = processor_time(answering.pid) + processor_time(asking.pid)
    asking.stdout.readline()
    after = processor_time(answering.pid) + processor_time(asking.pid)
    trips = np.array([float(trip) for trip in asking.stdout.readline().split()])
    asking.wait(20)
    answering.send_signal(signal.SIGINT)
    answering.wait(20)
    return trips, (after - before) / len(trips)


def compare(lockstep: Spec, realtime: Spec, rounds: int, ways: Sequence[str] = WAYS) -> None:
    """Print the gain of the cycle in one process over separate processes, or the results of one of both ways."""
    period = realtime.settings.control_period
    runs: dict[str, list[Run]] = {f"{timing}, {way}": [] for timing in TIMINGS for way in ways}
    echoes = []
    for number in range(rounds):
        for timing, spec in zip(TIMINGS, (lockstep, realtime), strict=True):
            for way in ways[:: (-1) ** number]:
                runs[f"{timing}, {way}"].append(measured_run(spec, timing, compose=way == COMPOSED))
        echoes.append(paced_echo(period))
    print(f"{rounds} rounds: median (quartiles); load {os.getloadavg()[0]:.1f}")
    for name, done in runs.items():
        told = [one.told for one in done]
        print(f"{name:20s} x real time {quartiles([one.rate * period for one in done], '.2f')}")
        print(f"{'':20s} processor, us a cycle {quartiles([1e6 * one.cost for one in done], '.0f')}")
        for part in PARTS:
            print(f"{'':20s} response {part:6s} us {quartiles([1e6 * one.response[part] for one in told], '.0f')}")
        cycles = (lockstep if name.startswith(LOCKSTEP) else realtime).cycles
        print(f"{'':20s} of {cycles} cycles missed {[one.missed for one in told]}, late {[one.late for one in told]},", end=" ")
        print(f"not in the bag {[one.lost for one in done]}; slipped {quartiles([one.slipped for one in told], '.3f')} s")
    for part, quantile in zip(PARTS, (50, 99, 99.9, 100), strict=True):
        trips = [1e6 * np.percentile(t, quantile) for t, _ in echoes]
        print(f"{'empty echo':20s} round trip {part:6s} us {quartiles(trips, '.0f')}")
    print(f"{'':20s} processor, us a round trip {quartiles([1e6 * cost for _, cost in echoes], '.0f')}")
    for timing in TIMINGS if set(WAYS) == set(ways) else ():
        pairs = list(zip(runs[f"{timing}, {COMPOSED}"], runs[f"{timing}, {APART}"], strict=True))
        print(f"{timing}: composed / apart: rate {quartiles([one.rate / two.rate for one, two in pairs], '.2f')},", end=" ")
        print(f"processor {quartiles([one.cost / two.cost for one, two in pairs], '.2f')}")


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--lockstep-seconds", type=float, default=10.0, help="plant time of each lockstep run")
    parser.add_argument("--realtime-seconds", type=float, default=30.0, help="plant time of the realtime run")
    parser.add_argument("--rounds", type=int, default=5, help="lockstep runs")
    parser.add_argument("--compose", action="store_true", help="compare the cycle in one process with each node in its own")
    parser.add_argument("--only", choices=WAYS, help="with --compose, run in this way only")
    parser.add_argument("--period", type=float, default=1e-3, help="control period [s]")
    parser.add_argument("--echo", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.echo:
        answer_echoes()
        return
    spec = load_spec(config_folder() / "experiments" / "sine_fd2.yaml")
    settings = spec.settings._replace(control_period=options.period)
    spec = spec._replace(settings=settings)
    print(
        f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}, Python {platform.python_version()}"
    )

    lockstep = spec._replace(settings=settings._replace(duration=options.lockstep_seconds))
    realtime = spec._replace(settings=settings._replace(duration=options.realtime_seconds))
    if options.compose:
        compare(lockstep, realtime, options.rounds, (options.only,) if options.only else WAYS)
        return
    rates = []
    for number in range(options.rounds):
        trajectory, wall = run(lockstep, "lockstep")
        rates.append((len(trajectory) - 1) * settings.control_period / wall)
        print(f"lockstep {number + 1}: {len(trajectory) / wall:6.0f} cycles/s = {rates[-1]:.2f} x real time")
    if rates:
        print(f"lockstep median {np.median(rates):.2f} x real time, {min(rates):.2f} to {max(rates):.2f}")

    trajectory, _ = run(realtime, "realtime")
    metrics = evaluate(trajectory)
    lost = int(np.sum(~np.isfinite(trajectory["force_n"]))) + realtime.cycles - len(trajectory)
    response = trajectory["response_s"]
    answers = metrics.cycles - metrics.missed_cycles
    print(f"realtime {options.realtime_seconds:.0f} s: {answers} of {metrics.cycles} cycles answered,")
    kept = "in real time" if metrics.in_real_time else "not in real time"
    reached, asked = metrics.cycles_per_second_reached or 0.0, metrics.cycles_per_second_asked or 0.0
    print(f"  {kept}: {reached:.0f} of {asked:.0f} cycles/s, load {os.getloadavg()[0]:.1f},")
    print(f"  {lost} samples lost in the bag, largest error in the last half {metrics.max_error_n:.0f} N")
    print("                                     p50      p99    p99.9      max  [us]")
    answered = response[np.isfinite(response)]
    print(f"snapshot to command            {percentiles(answered)}")
    echo = echo_round_trips()
    print(f"empty rclpy echo, there and back{percentiles(echo)[1:]}")
    print(f"ratio to the echo at p50 {np.median(answered) / np.median(echo):.2f}")


if __name__ == "__main__":
    main()
