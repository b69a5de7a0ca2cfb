"""Load cycles of a programme over DDS in lockstep, with a stop, a resume and a killed programme node: is each counted once?

usage: python -m benchmarks.programme_endurance [--cycles 20000]

Each load cycle has ten control cycles of 1 ms. At 10 % of the load cycles the programme is stopped and resumed. At 40 % its
node is killed with SIGKILL and restarted, at 50 % it is killed while it is stopped, and resumed. The log is judged.
"""

import csv
import itertools
import os
import platform
import signal
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from benchmarks.common import parser_of
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.programme_records import LOG
from ehls_ros.nodes.control import NAMESPACE
from ehls_ros.nodes.graph import Running, graph_environment, last_line, node_processes
from ehls_ros.nodes.graph_nodes import PROGRAMME

SAMPLES = 10
PERIOD = 1e-3
PATIENCE = 300.0
"""Timeout for a new load cycle [s]; it ends a hung run."""

LONGEST_PAUSE = 30.0
"""Longest pause of the rig in which a request is repeated [s]."""

LOOK = 0.05
"""Interval between checks of the log [s]."""

STOP_TIME = 0.05
HOLD_TIME = 0.1

QUIET = 3.0
"""Time without a load cycle after which a stop counts as completed: a busy machine may hold the graph up for a second [s]."""

FOLLOWED = {"programme_stop": "the programme is stopped", "programme_resume": "the programme is not stopped"}
"""The node's answer to a request that was carried out before."""

NODES = (PROGRAMME, "disturbance_node", "sic_node", "plant_sim_node")

FILE = """title: endurance
hold: 0.0
transition: 0.05
stop_time: {stop}
hold_time: {hold}
blocks:
  - {{block: ramp, to: 1.0e+3, time: 0.1}}
  - repeat: {repeats}
    blocks:
      - {{block: cycles, name: large, mean: 1.5e+3, amplitude: 300.0, frequency: {frequency}, count: {large}}}
      - {{block: cycles, waveform: haversine, mean: 1.5e+3, amplitude: 150.0, frequency: {frequency}, count: {small}}}
"""

SPEC = """title: endurance
rig: {rig}
duration: 1.0e+6
reference: {{name: programme, file: programme.yaml}}
disturbance: {{name: force, signal: {{name: sine, amplitude: 2.0e+3, frequency: 1.0}}}}
controller: {{name: sic}}
"""


class Outcome(NamedTuple):
    """Contents of the log, and the memory of the programme node.

    Attributes:
        asked: load cycles of the programme.
        logged: lines of the log.
        once: load cycles that occur exactly once.
        whole: load cycles whose control cycles are all consecutive.
        stretched: load cycles with more: the programme was stopped or resumed in them.
        lost: control cycles between two load cycles of one pass that belong to none.
        rates: load cycles per second of wall time.
        memory: resident memory of the programme node, in order of time, one list for each of its starts [MiB].
    """

    asked: int
    logged: int
    once: int
    whole: int
    stretched: int
    lost: int
    rates: float
    memory: list[list[float]]


def endure(folder: Path, cycles: int) -> Outcome:
    """Run the programme and judge its log.

    Args:
        folder: for the files; empty.
        cycles: load cycles, a multiple of 100.
    """
    frequency = 1.0 / (SAMPLES * PERIOD)
    repeats = 10
    each = cycles // repeats
    text = FILE.format(
        repeats=repeats, large=each - each // 5, small=each // 5, frequency=frequency, stop=STOP_TIME, hold=HOLD_TIME
    )
    (folder / "programme.yaml").write_text(text, encoding="utf-8")
    spec = folder / "spec.yaml"
    spec.write_text(SPEC.format(rig=config_folder() / "rig_paper.yaml"), encoding="utf-8")
    environment = graph_environment()
    os.environ.update({key: environment[key] for key in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")})
    common = {"spec": str(spec), "timing": "lockstep"}
    own: dict[str, dict[str, Any]] = {name: dict(common) for name in NODES}
    own[PROGRAMME]["folder"] = str(folder)
    own["plant_sim_node"]["partners"] = ",".join(NODES[:-1])
    with ExitStack() as stack:
        ask = stack.enter_context(_Asker())
        graph = stack.enter_context(node_processes(list(NODES[1:]), own, folder, environment))
        runner = _Runner(folder, own, environment, graph, stack)
        runner.start()
        began = time.monotonic()
        runner.until(cycles // 10)
        runner.ask_standing(ask, "programme_stop")
        runner.until_quiet()
        ask("programme_resume")
        runner.until(cycles * 4 // 10)
        runner.kill()
        runner.start()
        runner.until(cycles // 2)
        runner.ask_standing(ask, "programme_stop")
        runner.until_quiet()
        runner.kill()
        runner.start()
        ask("programme_resume")
        runner.until(cycles)
        wall = time.monotonic() - began
    return judge(folder / LOG, cycles, wall, runner.memory)


def judge(log: Path, cycles: int, wall: float, memory: list[list[float]]) -> Outcome:
    """Evaluate a log against the requested load cycles."""
    with log.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    numbers = [int(row["load_cycle"]) for row in rows]
    samples = [int(row["samples"]) for row in rows]
    span = [(int(row["first"]), int(row["last"])) for row in rows]
    on_end = [n == last - first + 1 for n, (first, last) in zip(samples, span, strict=True)]
    gaps = [
        one[0] - before[1] - 1
        for (before, one), row in zip(itertools.pairwise(span), rows[1:], strict=True)
        if int(row["cycle"]) > 1
    ]
    counts = np.bincount(numbers, minlength=cycles + 1)[1:]
    return Outcome(
        asked=cycles,
        logged=len(rows),
        once=int((counts[:cycles] == 1).sum()),
        whole=sum(n == SAMPLES and whole for n, whole in zip(samples, on_end, strict=True)),
        stretched=sum(n > SAMPLES for n in samples),
        lost=sum(gap for gap in gaps if gap < HOLD_TIME / PERIOD),
        rates=cycles / wall,
        memory=memory,
    )


class _Runner:
    """The graph, whose programme node is killed and started."""

    def __init__(
        self, folder: Path, own: dict[str, dict[str, Any]], environment: dict[str, str], graph: list[Running], stack: ExitStack
    ) -> None:
        self.memory: list[list[float]] = []
        self._folder, self._own, self._environment, self._graph, self._stack = folder, own, environment, graph, stack
        self._running: Running

    def start(self) -> None:
        nodes = node_processes([PROGRAMME], self._own, self._folder, self._environment)
        self.memory.append([])
        [self._running] = self._stack.enter_context(nodes)

    def kill(self) -> None:
        self._running.process.kill()
        self._running.process.wait()

    def ask_standing(self, ask: "_Asker", service: str) -> None:
        """Ask while the rig pauses: a node may be discovered only seconds after its start, when the programme could be over.

        The pause may hit the rig within shared memory that others then wait for; so the rig goes on and pauses again.
        """
        plant, asked = self._graph[-1].process, list[Any]()
        deadline = time.monotonic() + PATIENCE
        while True:
            plant.send_signal(signal.SIGSTOP)
            try:
                ask(service, asked, LONGEST_PAUSE)
            except TimeoutError:
                if time.monotonic() > deadline:
                    raise
            else:
                return
            finally:
                plant.send_signal(signal.SIGCONT)
            time.sleep(LOOK)

    def until(self, count: int) -> None:
        """Wait for a number of load cycles in the log."""
        self._wait(lambda done, _: done >= count)

    def until_quiet(self) -> None:
        """Wait until no load cycle has come for a while."""
        self._wait(lambda _, quiet: quiet > QUIET)

    def _wait(self, over: Callable[[int, float], bool]) -> None:
        last, since = -1, time.monotonic()
        while True:
            done = self._logged()
            if done != last:
                last, since = done, time.monotonic()
            quiet = time.monotonic() - since
            if over(done, quiet):
                return
            if quiet > PATIENCE:
                raise TimeoutError(f"no load cycle for {PATIENCE:g} s after {done}")
            for node in (*self._graph, self._running):
                if node.process.poll() is not None:
                    raise RuntimeError(f"{node.name} ended: {last_line(node.log)}")
            self._look()
            time.sleep(LOOK)

    def _logged(self) -> int:
        """Return the load cycle in the log's last whole line."""
        try:
            with (self._folder / LOG).open("rb") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - 4096))
                lines = file.read().rpartition(b"\n")[0].splitlines()
        except OSError:
            return 0
        word = lines[-1].split(b",")[0] if lines else b""
        return int(word) if word.isdigit() else 0

    def _look(self) -> None:
        status = Path(f"/proc/{self._running.process.pid}/status").read_text(encoding="utf-8")
        resident = next((line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")), "0")
        self.memory[-1].append(int(resident) / 1024)


class _Asker:
    """Client of the graph's services that retries until a request succeeds."""

    def __enter__(self) -> Self:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("asker", context=self._context, namespace=NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        # Discovered in advance: the programme does not wait for discovery.
        self._clients = {name: self._node.create_client(Trigger, name) for name in ("programme_stop", "programme_resume")}
        return self

    def __call__(self, service: str, asked: list[Any] | None = None, patience: float = PATIENCE) -> None:
        """Ask; ``asked`` holds the requests so far, answered or not."""
        client, asked = self._clients[service], [] if asked is None else asked
        deadline = time.monotonic() + patience
        said = "it does not answer"
        while time.monotonic() < deadline:
            # A killed node still seems to be present for a while, and swallows requests.
            if client.wait_for_service(1.0):
                asked.append(client.call_async(Trigger.Request()))
                self._executor.spin_until_future_complete(asked[-1], 1.0)
                answers = [future.result() for future in asked if future.done()]
                said = answers[-1].message if answers else said
                # An unanswered request may have been carried out all the same; then the next is refused for that reason.
                followed = len(answers) < len(asked) and said == FOLLOWED[service]
                if followed or any(answer.success for answer in answers):
                    break
            time.sleep(LOOK)
        else:
            raise TimeoutError(f"{service}: {said}")

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--cycles", type=int, default=20_000, help="load cycles, a multiple of 100")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = endure(Path(folder), options.cycles)
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    print(f"load cycles asked for               {found.asked}")
    print(f"lines of the log                    {found.logged}")
    print(f"load cycles logged exactly once     {found.once}")
    print(f"of these with 10 control cycles     {found.whole}")
    print(f"of these with more: stop, resume    {found.stretched}")
    print(f"control cycles lost between them    {found.lost}")
    print(f"load cycles per second              {found.rates:.0f}")
    for number, memory in enumerate(found.memory, 1):
        # The first part of each is starting up.
        settled = memory[len(memory) // 5 :] or [0.0]
        print(f"memory of the node, start {number}         {settled[0]:.1f} to {settled[-1]:.1f} MiB")


if __name__ == "__main__":
    main()
