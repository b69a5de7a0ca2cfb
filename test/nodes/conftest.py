"""Nodes as processes, and the test's participant in the graph."""

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
from policies.trace import Call, Journal

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
"""Time that the nodes have to exit before they are killed [s]."""

ASK_AGAIN, LOOK_AGAIN = 3.0, 0.5
"""Time after which an unanswered request is repeated, and one without effect [s]."""

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
    """The processes that a test starts: nodes by the server, if there is one, and other programs directly."""

    def __init__(self, folder: Path, server: NodeServer | None = None) -> None:
        self.folder, self._server = folder, server
        self.processes: dict[str, Any] = {}
        self.journal = Journal()

    def start(self, name: str, *, remap: str = "", **parameters: Any) -> Any:
        arguments = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        arguments += ["-r", remap] if remap else []
        return self.run(name, ["-m", f"ehls_ros.nodes.{name}", "--ros-args", *arguments])

    def run(self, name: str, arguments: list[str], before: Mapping[str, Any] | None = None) -> Any:
        """Start a Python process; ``before`` as for the server."""
        from ehls_ros.nodes.graph import graph_environment

        began = time.monotonic()
        log, environment = self.folder / f"{name}.log", {"ROS_LOG_DIR": str(self.folder), **graph_environment()}
        if self._server is not None and self._server.serves(arguments, environment):
            log.touch()
            self.processes[name] = self._server.start(arguments, log, environment, before)
        else:
            with log.open("ab") as output:
                self.processes[name] = subprocess.Popen(
                    [sys.executable, *arguments],
                    env=environment,
                    stdin=subprocess.PIPE,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                )
        self.journal.note("started", name, began, self.processes[name].pid)
        return self.processes[name]

    def note_ended(self) -> None:
        """Note the processes that have ended unprompted since."""
        for name, process in self.processes.items():
            ended = any(h.code == process.pid and h.what == "gone" for h in self.journal.happenings)
            if process.poll() is not None and not ended:
                self.journal.note("gone", name, code=process.pid)

    def limit_files(self, name: str, size: int) -> None:
        """Limit any file that a process writes to ``size`` bytes from now on."""
        resource.prlimit(self.processes[name].pid, resource.RLIMIT_FSIZE, (size, size))

    def tell(self, name: str, line: str) -> None:
        """Write a line to a process's standard input."""
        stdin = self.processes[name].stdin
        stdin.write(f"{line}\n".encode())
        stdin.flush()

    def kill(self, name: str) -> float:
        """Kill a process and return the monotonic time at which it was gone [s]."""
        process = self.processes.pop(name)
        self.journal.note("stopped", name)
        process.kill()
        process.wait(PATIENCE)
        return self.journal.note("killed", name)

    def freeze(self, process: Any) -> float:
        """Stop a process with SIGSTOP, and return the monotonic time at which all its threads had stopped [s]."""
        process.send_signal(signal.SIGSTOP)
        tasks = Path(f"/proc/{process.pid}/task")
        while any(_state_of(task) not in "TZX" for task in tasks.iterdir()):
            time.sleep(1e-4)
        return self.journal.note("frozen", self._name_of(process))

    def wake(self, process: Any) -> float:
        """Resume a stopped process, and return the monotonic time before that [s]."""
        woken = self.journal.note("woken", self._name_of(process))
        process.send_signal(signal.SIGCONT)
        return woken

    def _name_of(self, process: Any) -> str:
        return next((name for name, known in self.processes.items() if known is process), "another process")

    def stop(self, name: str, number: int = signal.SIGINT) -> int:
        process = self.processes[name]
        self.journal.note("stopped", name)
        process.send_signal(number)
        code = process.wait(PATIENCE)
        self.journal.note("killed" if number == signal.SIGKILL else "ended", name, code=code)
        # A hung one stays, and is killed after the test.
        del self.processes[name]
        return code

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text(encoding="utf-8")


def _state_of(task: Path) -> str:
    """Return the state of a thread according to /proc; X if it has ended."""
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
    """Return a function that writes an experiment file into the test's folder and returns its path."""
    return partial(write_spec, tmp_path)


class Heard(list[Any]):
    """Messages of a topic, in order of arrival.

    Attributes:
        published_ns: when each was published, by the system's clock [ns].
        publishers: returns the number of publishers it has discovered. Their earlier messages may be lost to it, except for
            the newest messages of those that keep some.
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
        self.journal = Journal()
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def rest(self, seconds: float) -> None:
        """Spin for a while."""
        deadline = time.monotonic() + seconds
        while (remaining := deadline - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=remaining)

    def until(self, condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
        """Spin until a condition holds; ``seconds`` end a hung test."""
        deadline = time.monotonic() + seconds
        while not condition():
            self.executor.spin_once(timeout_sec=0.05)
            assert time.monotonic() < deadline, "the condition was not met in time"

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Return a service's answer; the request is repeated until the first answer."""
        return self.ask(kind, service, request)[0]

    def ask(self, kind: Any, service: str, request: Any) -> tuple[Any, bool]:
        """Return a service's answer, and whether an earlier request whose answer got lost may have been carried out."""
        client = self.node.create_client(kind, service)
        sent = time.monotonic()
        deadline = sent + PATIENCE
        wait = LOOK_AGAIN if kind.__name__.startswith(("Get", "List", "Describe")) else ASK_AGAIN
        asked: list[Any] = []

        def answers() -> list[Any]:
            return [future.result() for future in asked if future.done()]

        while not answers():
            assert time.monotonic() < deadline, f"{service} does not answer"
            self.until(client.service_is_ready)
            asked.append(client.call_async(request))
            # A killed server still seems to be present for a while, and swallows requests; a new one may lose its answer.
            again = time.monotonic() + wait
            self.until(lambda again=again: answers() or time.monotonic() > again)
            wait *= 2.0
        self.node.destroy_client(client)
        repeated = not asked[0].done()
        call = _call_of(service, request, sent, answers()[0])
        # A refusal gives no information on an earlier request whose answer got lost.
        self.journal.calls.append(call._replace(success=None) if repeated and not call.success else call)
        return answers()[0], repeated

    def note_unanswered(self, service: str, request: Any) -> None:
        """Note a request whose answer is not awaited; call it before sending."""
        self.journal.calls.append(_call_of(service, request, time.monotonic(), None))

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
        # A graph in lockstep is faster than this executor: waiting messages must not be overwritten.
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


def _call_of(service: str, request: Any, sent: float, answer: Any) -> Call:
    """Return the record of a request and its answer, None if there is none; a parameter is recorded by name and value."""
    fields = {name: getattr(request, name) for name in request.get_fields_and_field_types()}
    if "transition" in fields:
        fields["transition"] = request.transition.label
    if "parameters" in fields and len(request.parameters) == 1:
        from rclpy.parameter import parameter_value_to_python

        [parameter] = request.parameters
        with contextlib.suppress(RuntimeError):
            fields |= {"name": parameter.name, "value": parameter_value_to_python(parameter.value)}
    if answer is None:
        return Call(service, fields, sent)
    results = getattr(answer, "results", [answer])
    success = all(getattr(result, "successful", getattr(result, "success", True)) for result in results)
    return Call(service, fields, sent, time.monotonic(), success, getattr(answer, "message", ""))


@pytest.fixture
def participant(ros_domain_id: int) -> Iterator[Participant]:
    present = Participant()
    yield present
    present.close()
