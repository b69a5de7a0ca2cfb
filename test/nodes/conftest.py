"""Nodes as processes, and the test's own participant."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from node_server import NodeServer
from patience import PATIENCE

from ehls_ros.control.controllers import CONTROLLERS

SPEC = """
title: a short run
rig: {rig}
duration: {duration}
reference: {reference}
disturbance: {{name: force, signal: {{name: sine, amplitude: 5.0e+3, frequency: 1.0}}}}
controller: {{name: {controller}}}
"""

FORCE = "{name: sine, amplitude: 1.0e+4, frequency: 0.5}"
POSITION = "{name: velocity_sweep, velocities: [0.02], travel: 2.0e-3, rest: 0.02}"

GRACE = 120.0
"""Time the nodes have to exit before they are killed [s]."""

ASK_AGAIN, LOOK_AGAIN = 3.0, 0.5
"""Time after which an unanswered request is repeated, and one that changes nothing [s]."""

GOALS = {
    "configure": "inactive",
    "activate": "active",
    "deactivate": "inactive",
    "cleanup": "unconfigured",
    "shutdown": "finalized",
}
"""State that a lifecycle transition leads to."""

RIG = Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml"


@pytest.fixture(scope="session", autouse=True)
def ros() -> None:
    """Skip the tests of this folder without ROS; a skip of this file as a whole would end the session."""
    pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy or its wheels")
    pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")


class Graph:
    """The processes a test starts: nodes by the server, if there is one, and other programs by themselves."""

    def __init__(self, folder: Path, server: NodeServer | None = None) -> None:
        self.folder, self._server = folder, server
        self.processes: dict[str, Any] = {}

    def start(self, name: str, *, remap: str = "", **parameters: Any) -> Any:
        arguments = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        arguments += ["-r", remap] if remap else []
        return self.run(name, ["-m", f"ehls_ros.nodes.{name}", "--ros-args", *arguments])

    def run(self, name: str, arguments: list[str], before: Mapping[str, Any] | None = None) -> Any:
        """Start a Python process; ``before`` as for the server."""
        from ehls_ros.nodes.graph import graph_environment

        log, environment = self.folder / f"{name}.log", {"ROS_LOG_DIR": str(self.folder), **graph_environment()}
        if self._server is not None and self._server.serves(arguments, environment):
            log.touch()
            self.processes[name] = self._server.start(arguments, log, environment, before)
            return self.processes[name]
        with log.open("ab") as output:
            self.processes[name] = subprocess.Popen(
                [sys.executable, *arguments],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        return self.processes[name]

    def limit_files(self, name: str, size: int) -> None:
        """Let no file that a process writes grow beyond ``size`` bytes from now on."""
        resource.prlimit(self.processes[name].pid, resource.RLIMIT_FSIZE, (size, size))

    def tell(self, name: str, line: str) -> None:
        """Write a line to a process's standard input."""
        stdin = self.processes[name].stdin
        stdin.write(f"{line}\n".encode())
        stdin.flush()

    def kill(self, name: str) -> float:
        """Kill a process and return the monotonic time at which it was gone [s]."""
        process = self.processes.pop(name)
        process.kill()
        process.wait(PATIENCE)
        return time.monotonic()

    @staticmethod
    def freeze(process: Any) -> float:
        """Stop a process with SIGSTOP, and return the monotonic time at which all its threads had stopped [s]."""
        process.send_signal(signal.SIGSTOP)
        tasks = Path(f"/proc/{process.pid}/task")
        while any(_state_of(task) not in "TZX" for task in tasks.iterdir()):
            time.sleep(1e-4)
        return time.monotonic()

    def stop(self, name: str, number: int = signal.SIGINT) -> int:
        process = self.processes[name]
        process.send_signal(number)
        code = process.wait(PATIENCE)
        # One that hangs stays, and is killed after the test.
        del self.processes[name]
        return code

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text(encoding="utf-8")


def _state_of(task: Path) -> str:
    """Return the state of a thread, as /proc has it; X if it has ended."""
    try:
        return (task / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return "X"


@pytest.fixture(scope="session")
def node_server(nothing_left_behind: None) -> Iterator[NodeServer]:
    """Return the server that starts the nodes of all tests."""
    server = NodeServer()
    yield server
    server.close()


@pytest.fixture
def graph(tmp_path: Path, node_server: NodeServer) -> Iterator[Graph]:
    started = Graph(tmp_path, node_server)
    yield started
    for process in started.processes.values():
        process.send_signal(signal.SIGINT)
    for process in started.processes.values():
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(GRACE)
        process.kill()
        process.wait()


@pytest.fixture(scope="session")
def write_spec() -> Callable[..., Path]:
    """Return a function that writes an experiment file into a folder and returns its path."""

    def write(folder: Path, duration: float = 0.5, controller: str = "fasmc") -> Path:
        path = folder / "spec.yaml"
        reference = {"force": FORCE, "position": POSITION}[CONTROLLERS.load(controller).FOLLOWS]
        text = SPEC.format(rig=RIG, duration=duration, controller=controller, reference=reference)
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def spec_file(write_spec: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """Return the same for the test's own folder."""
    return partial(write_spec, tmp_path)


class Heard(list[Any]):
    """Messages of a topic, in order of arrival.

    Attributes:
        published_ns: when each was published, by the system's clock [ns].
        publishers: returns the number of publishers that it hears by now. What they sent before may be lost to it, except
            for the newest messages of those that keep some.
    """

    def __init__(self) -> None:
        super().__init__()
        self.published_ns: list[int] = []
        self.publishers: Callable[[], int] = lambda: 0

    def add(self, message: Any, info: dict[str, int]) -> None:
        """Receive a message."""
        self.append(message)
        self.published_ns.append(info["source_timestamp"])

    def clear(self) -> None:
        """Forget all messages."""
        super().clear()
        self.published_ns.clear()

    def after(self, moment_ns: int, first: int = 0) -> list[Any]:
        """Return the messages published after a moment [ns], however late they arrived; those before ``first`` are skipped."""
        published = zip(self[first:], self.published_ns[first:], strict=True)
        return [message for message, when in published if when > moment_ns]


class Participant:
    """A further participant of the graph, in the test's own process."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self.context = rclpy.Context()
        rclpy.init(
            context=self.context, domain_id=int(os.environ["ROS_DOMAIN_ID"]), signal_handler_options=SignalHandlerOptions.NO
        )
        self.node = rclpy.create_node("participant", context=self.context, namespace="ehls")
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def rest(self, seconds: float) -> None:
        """Spin for a while."""
        deadline = time.monotonic() + seconds
        while (remaining := deadline - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=remaining)

    def until(self, condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
        """Spin until a condition holds; ``seconds`` end a test that hangs."""
        deadline = time.monotonic() + seconds
        while not condition():
            self.executor.spin_once(timeout_sec=0.05)
            assert time.monotonic() < deadline, "the condition was not met in time"

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Return a service's answer; the request is repeated until the first answer."""
        return self.ask(kind, service, request)[0]

    def ask(self, kind: Any, service: str, request: Any) -> tuple[Any, bool]:
        """Do the same, and return as well whether an earlier request may have been followed whose answer got lost."""
        client = self.node.create_client(kind, service)
        deadline = time.monotonic() + PATIENCE
        wait = LOOK_AGAIN if kind.__name__.startswith(("Get", "List", "Describe")) else ASK_AGAIN
        asked: list[Any] = []

        def answers() -> list[Any]:
            return [future.result() for future in asked if future.done()]

        while not answers():
            assert time.monotonic() < deadline, f"{service} does not answer"
            self.until(client.service_is_ready)
            asked.append(client.call_async(request))
            # A killed server still seems to be there for a while, and swallows requests; a new one may lose its answer.
            again = time.monotonic() + wait
            self.until(lambda again=again: answers() or time.monotonic() > again)
            wait *= 2.0
        self.node.destroy_client(client)
        return answers()[0], not asked[0].done()

    def change(self, node: str, transition: str) -> bool:
        """Request a lifecycle node's transition, by its label, and return whether it was made."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        request = ChangeState.Request(transition=Transition(label=transition))
        answer, repeated = self.ask(ChangeState, f"{node}/change_state", request)
        return bool(answer.success) or (repeated and self.state_of(node) == GOALS[transition])

    def state_of(self, node: str) -> str:
        """Return the label of a lifecycle node's state."""
        from lifecycle_msgs.srv import GetState

        return str(self.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label)

    def collect(self, kind: Any, topic: str) -> Heard:
        from ehls_ros.nodes.transport import RECORDER_DEPTH, control_qos

        heard = Heard()
        # A graph in lockstep is faster than this executor: what waits for it must not be overwritten.
        qos = control_qos(RECORDER_DEPTH) if not topic.startswith("/") else 10
        heard.publishers = self.node.create_subscription(kind, topic, heard.add, qos).get_publisher_count
        return heard

    def publishers(self, topic: str) -> list[Any]:
        return self.node.get_publishers_info_by_topic(topic)

    def set_parameter(self, node: str, name: str, value: Any) -> Any:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def get_parameter(self, node: str, name: str) -> Any:
        from rcl_interfaces.srv import GetParameters

        return self.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name])).values[0]

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def participant(ros_domain_id: int) -> Iterator[Participant]:
    present = Participant()
    yield present
    present.close()
