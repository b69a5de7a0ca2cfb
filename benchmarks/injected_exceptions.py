"""An exception in every method of every node, apart and composed: whether it is reported, and the valve is at null first.

    python -m benchmarks.injected_exceptions                     # all nodes, first and 30th call
    python -m benchmarks.injected_exceptions --nodes hardware_bridge_node --ways composed

A case starts the graph with one method of one node made to raise, takes the node through deactivation and activation, and stops
it. The table counts, by node, the methods reached and the cases whose log has one line about the exception and a traceback
file. It also counts cases whose process ended with 1 (a refused request does not end it), and those that ended silently.
With a rig, the commands that its device received show whether the last one was null.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

sys.path.append(str(Path(__file__).resolve().parents[1] / "test" / "nodes"))
sys.path.append(str(Path(__file__).resolve().parents[1] / "test"))

from conftest import Graph, Participant
from injection import CLASSES, Injected, methods_of
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from node_server import COMMAND, NodeServer
from std_srvs.srv import SetBool

from benchmarks.common import parser_of, print_heading, print_row
from ehls_msgs.msg import LoaderState
from ehls_ros.experiments.files import config_folder
from ehls_ros.nodes.graph import free_domain
from ehls_ros.nodes.graph_nodes import PLUS, can_share
from ehls_ros.nodes.shared_memory import leftovers

SIMULATED = ("reference_node", "disturbance_node", "friction_estimator_node", "fasmc_node", "plant_sim_node")
ON_RIG = ("reference_node", "friction_estimator_node", "fasmc_output_feedback_node", "hardware_bridge_node")
"""Nodes of the two graphs, the plant last."""

CALLS = (1, 30)
"""Calls that raise: the first, and one within the cycles."""

CYCLES = 200
"""Cycles before the node is taken through its lifecycle."""

LONGEST = 60.0
"""Timeout of a step of a case [s]; it only ends a hung one."""

AFTER = 15.0
"""Longest time between the exception and the end of the process [s]."""

LINE = Injected.__name__
"""Word that marks the log line about the exception."""


class Outcome(NamedTuple):
    """Outcome of one case.

    Attributes:
        reached: whether the method was called that often.
        lines: lines of the log about the exception.
        code: exit code of the process; None if it continued.
        refused: whether a request was refused with the reason.
        null: whether the valve was at null when the process ended; None without a rig.
    """

    reached: bool
    lines: int
    code: int | None
    refused: bool
    null: bool | None

    @property
    def silent(self) -> bool:
        """Whether the node ended or continued without a message about the exception."""
        return self.reached and (self.lines == 0 or not (self.refused or self.code == 1))


class Case:
    """One run of a graph with one failing method."""

    def __init__(self, server: NodeServer, folder: Path, node: str, way: str) -> None:
        """Prepare the graph, in the ROS domain of the environment."""
        self.folder, self.node, self.way = folder, node, way
        self.graph, self.participant = Graph(folder, server), Participant()
        self.states = self.participant.collect(LoaderState, "loader_state")
        self.on_rig = node in {"hardware_bridge_node", "fasmc_output_feedback_node"}
        self.spec, self.writes = self._spec(), folder / "writes"
        self._enabling: Callable[[], bool] | None = None
        self._answer: Any = None

    def _spec(self) -> Path:
        rig = config_folder() / ("rig_paper_measured.yaml" if self.on_rig else "rig_paper.yaml")
        law = "fasmc_output_feedback" if self.on_rig else "fasmc"
        path = self.folder / "spec.yaml"
        reference = {"name": "sine", "amplitude": 2e3, "frequency": 1.0}
        disturbance = {"name": "force", "signal": {"name": "sine", "amplitude": 1e3, "frequency": 1.0}}
        content = {"rig": str(rig), "duration": 1e4, "reference": reference, "disturbance": disturbance, "controller": law}
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path

    def run(self, method: str, call: int) -> Outcome:
        """Run the graph with a method that raises in a given call."""
        mark = self.folder / "raised"
        before = {
            "module": "injection",
            "function": "inject",
            "arguments": {"node": self.node, "method": method, "call": call, "mark": str(mark), "writes": str(self.writes)},
        }
        try:
            process = self._start(before)
            self._live(process, mark)
            code = self._end(process)
        finally:
            self._close()
        name = "composed" if self.way == "composed" else self.node
        log = self.graph.log(name).splitlines()
        lines = [line for line in log if LINE in line]
        reported = [line for line in lines if "traceback" in line or "refused" in line]
        refused = any("request was refused" in line for line in lines)
        return Outcome(mark.exists(), len(reported), code, refused, self._null() if self.on_rig else None)

    def _start(self, before: Mapping[str, Any]) -> Any:
        common: dict[str, Any] = {"spec": self.spec, "timing": "lockstep"}
        names: Sequence[str] = ON_RIG if self.on_rig else SIMULATED
        own: dict[str, dict[str, Any]] = {"plant_sim_node": {"speed": 3.0}}
        if self.on_rig:
            own["hardware_bridge_node"] = {"bridge": self._emulator(), "enable_time": 0.1}
        if self.node not in names:
            own[self.node] = self._own_parameters()
            replaced = "reference_node" if self.node == "programme_node" else ""
            names = (self.node, *(name for name in names if name != replaced))
        if self.way == "composed":
            given = common | {key: value for parameters in own.values() for key, value in parameters.items()}
            arguments = ["-m", COMMAND, "run", PLUS.join(names), "--ros-args", *_words(given)]
            return self.graph.run("composed", arguments, before)
        for name in names:
            arguments = ["-m", f"ehls_ros.nodes.{name}", "--ros-args", *_words(common | own.get(name, {}))]
            self.graph.run(name, arguments, before if name == self.node else None)
        return self.graph.processes[self.node]

    def _own_parameters(self) -> dict[str, Any]:
        if self.node == "programme_node":
            file = self.folder / "programme.yaml"
            blocks = [{"block": "cycles", "amplitude": 500.0, "mean": 500.0, "frequency": 20.0, "count": 100000}]
            file.write_text(yaml.safe_dump({"title": "short", "blocks": blocks}), encoding="utf-8")
            return {"programme": file, "folder": self.folder / "programme"}
        return {"bag": self.folder / "bag"} if self.node == "recorder_node" else {"folder": self.folder / "monitor"}

    def _emulator(self) -> Path:
        wiring = yaml.safe_load((config_folder() / "bridge_udp.yaml").read_text(encoding="utf-8"))
        wiring["backend"]["port"] = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"]) + 249
        path = self.folder / "bridge.yaml"
        path.write_text(yaml.safe_dump(wiring), encoding="utf-8")
        words = ["--spec", str(self.spec), "--bridge", str(path), "--log", str(self.folder / "truth.csv")]
        self.graph.run("emulator", ["-m", COMMAND, "rig-emulator", *words, "--lockstep", "--patience", "600"])
        return path

    def _live(self, process: Any, mark: Path) -> None:
        """Take the node through its lifecycle, as far as possible."""
        for step in self._steps():
            deadline = time.monotonic() + LONGEST
            since = None
            while not step() and process.poll() is None:
                self.participant.rest(0.02)
                if mark.exists():
                    since = since or time.monotonic()
                    if time.monotonic() - since > AFTER:
                        return
                if time.monotonic() > deadline:
                    return
            if process.poll() is not None:
                return

    def _steps(self) -> Iterator[Callable[[], bool]]:
        yield lambda: bool(self.states) and self.states[-1].cycle >= CYCLES
        if self.on_rig:
            yield self._enable
            now = self.states[-1].cycle
            yield lambda: self.states[-1].cycle >= now + CYCLES
        for label in ("deactivate", "activate", "deactivate", "cleanup", "configure", "activate"):
            yield self._change(label)
        moment = time.monotonic()
        yield lambda: time.monotonic() > moment + 1.5

    def _change(self, label: str) -> Callable[[], bool]:
        request = ChangeState.Request(transition=Transition(label=label))
        return self._asked(ChangeState, f"{self.node}/change_state", request)

    def _enable(self) -> bool:
        if self._enabling is None or (self._enabling() and not self._answer.success):
            self._enabling = self._asked(SetBool, "enable", SetBool.Request(data=True))
        return bool(self._enabling() and self._answer.success)

    def _asked(self, kind: Any, service: str, request: Any) -> Callable[[], bool]:
        """Return a function that calls a service once it is available and returns whether it has answered."""
        client = self.participant.node.create_client(kind, service)
        future: list[Any] = []

        def answered() -> bool:
            if not future and client.service_is_ready():
                future.append(client.call_async(request))
            if future and future[0].done():
                self._answer = future[0].result()
                return True
            return False

        return answered

    def _end(self, process: Any) -> int | None:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            return int(process.wait(LONGEST))
        except subprocess.TimeoutExpired:
            return None

    def _close(self) -> None:
        for process in self.graph.processes.values():
            process.send_signal(signal.SIGINT)
        for process in self.graph.processes.values():
            process.wait(LONGEST)
        self.participant.close()

    def _null(self) -> bool:
        """Return whether the last command that the device received was null."""
        commands = self.writes.read_text(encoding="utf-8").split() if self.writes.exists() else []
        return not commands or float(commands[-1]) == 0.0


def _words(parameters: Mapping[str, Any]) -> list[str]:
    return [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]


def ways_of(node: str, wanted: Sequence[str]) -> list[str]:
    """Return the ways in which a node is run."""
    return [way for way in wanted if way == "apart" or can_share(node)]


COUNTS = {
    "cases": "cases",
    "reached": "reached",
    "reported": "reported",
    "ended": "ended with 1",
    "refused": "refused",
    "silent": "silent",
    "open": "not at null",
}
"""Counted outcomes and the headings of their columns."""


def main() -> int:
    """Run and print."""
    parser = parser_of(__doc__)
    parser.add_argument("--nodes", nargs="+", default=list(CLASSES), choices=list(CLASSES))
    parser.add_argument("--ways", nargs="+", default=["apart", "composed"], choices=["apart", "composed"])
    parser.add_argument("--calls", nargs="+", type=int, default=list(CALLS))
    parser.add_argument("--methods", nargs="+", help="methods to fail; all by default")
    options = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    server = NodeServer()
    total: Counter[str] = Counter()
    print_heading("node", "way", "methods", *COUNTS.values(), "s")
    for node in options.nodes:
        methods = options.methods or sorted(methods_of(node))
        for way in ways_of(node, options.ways):
            begun, counts = time.monotonic(), Counter[str]()
            for method in methods:
                for call in options.calls:
                    with tempfile.TemporaryDirectory(prefix="injected_") as name:
                        os.environ["ROS_DOMAIN_ID"], os.environ["ROS_LOG_DIR"] = str(free_domain()), name
                        outcome = Case(server, Path(name), node, way).run(method, call)
                    if outcome.silent or outcome.null is False:
                        print(f"  {node} {way} {method} call {call}: {outcome}", file=sys.stderr, flush=True)
                    counts.update(_counted(outcome))
                    if not outcome.reached:
                        # A later call will not occur either.
                        break
            total += counts
            print_row(node, way, len(methods), *(counts[key] for key in COUNTS), f"{time.monotonic() - begun:.0f}")
    print_row("all", "", 0, *(total[key] for key in COUNTS), 0)
    server.close()
    for file in leftovers():
        file.unlink(missing_ok=True)
    return 1 if total["silent"] or total["open"] else 0


def _counted(outcome: Outcome) -> Mapping[str, int]:
    return {
        "cases": 1,
        "reached": outcome.reached,
        "reported": outcome.reached and outcome.lines > 0,
        "ended": outcome.reached and outcome.code == 1,
        "refused": outcome.reached and outcome.refused,
        "silent": outcome.silent,
        "open": outcome.null is False,
    }


if __name__ == "__main__":
    sys.exit(main())
