"""Requests to the safety gate and the programme of a running rig, and their reports."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import Executor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.msg import LoaderState
from ehls_msgs.srv import AcknowledgeStop
from ehls_ros.dashboard.graph import Answer, NodeHealth, until_granted
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.hardware.realtime import prefer, threads
from ehls_ros.nodes.codec import NANOSECONDS, Decoder
from ehls_ros.nodes.diagnostics import figures_of
from ehls_ros.nodes.graph_nodes import PROGRAMME
from ehls_ros.nodes.parameter_requests import FOUND, LOOK, Requests, checked_namespace, joined
from ehls_ros.nodes.transport import Inbox, control_qos
from ehls_ros.recording.topics import LOADER_STATE, OF_GATE

REPORTED = 3.0
"""Longest wait for the diagnostics of a node, which are due every second [s]."""

SAMPLED = 1.0
"""Longest wait for a snapshot [s]."""

PRIORITY = 1
"""SCHED_FIFO priority of the requests, where permitted: below the loops of a rig in real time, which leave ordinary processes
little time, such as one that is to stop the rig."""

REPORT_DEPTH = 100
"""Queue depth for diagnostics."""


class Sample(NamedTuple):
    """The newest snapshot of the rig: number of the cycle, and its age [s]."""

    cycle: int
    age_s: float


class RigRequests(Requests):
    """Client of one rig.

    Attributes:
        namespace: of its nodes.
        where: its domain and namespace, as text.
    """

    def __init__(self, node: Node, executor: Executor, namespace: str) -> None:
        """Send requests as a node; see :func:`rig_requests`."""
        super().__init__(node, executor)
        self.namespace = namespace
        self.where = f"ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')}, namespace /{self.namespace}"
        self._reports: dict[str, NodeHealth] = {}
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, REPORT_DEPTH)
        self._states = Inbox(node, LoaderState, f"/{self.namespace}/{LOADER_STATE.name}", control_qos(1))

    def close(self) -> None:
        """Unsubscribe."""
        self._states.destroy()

    def stop(self) -> str:
        """Stop the rig at once; return the answer, which begins with the name of the stop."""
        return self._gate("emergency_stop", Trigger, Trigger.Request())

    def acknowledge(self, stop: str) -> str:
        """Acknowledge an emergency stop; return the answer.

        Args:
            stop: its name; empty: the engaged one.
        """
        stop = stop or self.gate().figures.get("stop", "")
        if not stop:
            raise WorkFailed("no emergency stop is engaged")
        return self._gate("acknowledge_stop", AcknowledgeStop, AcknowledgeStop.Request(stop=stop), retry=True)

    def unload(self) -> str:
        """Let the load pressure decay, then close the valve; return the answer."""
        return self._gate("unload", Trigger, Trigger.Request())

    def reset(self) -> str:
        """Clear the trip; return the answer."""
        return self._gate("reset_trips", Trigger, Trigger.Request(), retry=True)

    def enable(self) -> str:
        """Let commands reach the valve; return the answer."""
        return self._gate("enable", SetBool, SetBool.Request(data=True), retry=True)

    def programme(self, request: str) -> str:
        """Stop, resume or skip in the programme; return the answer.

        Args:
            request: ``stop``, ``resume`` or ``skip``.
        """
        service = self._service(f"programme_{request}")
        # A repeated skip would leave out two blocks.
        answer = self.call(Trigger, service, Trigger.Request(), repeat=request != "skip")
        if not answer.success:
            raise WorkFailed(f"{request} refused: {answer.message}")
        return str(answer.message)

    def gate(self) -> NodeHealth:
        """Return the report of the node with the safety gate."""
        self._service("emergency_stop")
        return self._awaited("the plant node", lambda report: OF_GATE in report.figures)

    def running_programme(self) -> NodeHealth:
        """Return the report of the programme node."""
        self._service("programme_stop")
        return self._awaited(PROGRAMME, lambda report: report.node == PROGRAMME)

    def programme_if_any(self) -> NodeHealth | None:
        """Return the report of the programme node; None if no programme node runs."""
        return self.running_programme() if any(name.endswith(f"/{PROGRAMME}") for name in self.present()) else None

    def sample(self) -> Sample | None:
        """Return the newest snapshot of the rig; None if there is none."""
        deadline, newest = time.monotonic() + SAMPLED, None
        while newest is None and time.monotonic() < deadline:
            rclpy.spin_once(self._node, executor=self._executor, timeout_sec=LOOK)
            while (taken := self._states.take_raw()) is not None:
                newest = taken
        if newest is None:
            return None
        decoded = Decoder(LoaderState)(newest[0])
        return (
            None
            if decoded is None
            else Sample(decoded[1], max(0.0, (time.time_ns() - newest[1]["source_timestamp"]) / NANOSECONDS))
        )

    def _gate(self, service: str, kind: Any, request: Any, *, retry: bool = False) -> str:
        """Return the answer of a service of the gate; ``retry``: repeat the request while it is refused for the moment."""
        full = self._service(service)

        def ask() -> Answer:
            response = self.call(kind, full, request)
            return Answer(response.success, str(response.message))

        answer = until_granted(ask) if retry else ask()
        if not answer.done:
            raise WorkFailed(f"{service} refused: {answer.message}")
        return answer.message

    def _service(self, name: str) -> str:
        """Return the full name of a service once a node offers it.

        Raises:
            BadInput: none does.
        """
        full, deadline = f"/{self.namespace}/{name}", time.monotonic() + FOUND
        while not any(offered == full for offered, _ in self._node.get_service_names_and_types()):
            if time.monotonic() > deadline:
                raise self._nothing("programme" if name.startswith("programme") else "rig")
            time.sleep(LOOK)
        return full

    def _nothing(self, sought: str) -> BadInput:
        """Return the error for a rig or programme that does not run here, with where others run and how to start one."""
        from ehls_ros.nodes.graph import domains_in_use  # a second that an emergency stop must not wait

        own = os.environ.get("ROS_DOMAIN_ID", "0")
        others = [str(domain) for domain in domains_in_use() if str(domain) != own]
        elsewhere = f"ROS_DOMAIN_ID of a running one (in use on this computer: {', '.join(others)}); or " if others else ""
        start = {
            "rig": "a rig started with `ehls experiment`, `ehls dashboard --spec` or ros2 launch",
            "programme": "a programme started with `ehls programme FILE --run`, or an experiment whose reference is one",
        }
        return BadInput(f"no {sought} is found", self.where, f"{elsewhere}{start[sought]}")

    def _awaited(self, name: str, fits: Callable[[NodeHealth], bool]) -> NodeHealth:
        """Return the report that fits, once it has arrived."""
        deadline = time.monotonic() + REPORTED
        while not (found := [report for report in self._reports.values() if fits(report)]):
            if time.monotonic() > deadline:
                raise WorkFailed(f"{name} has not published diagnostics for {REPORTED:g} s ({self.where})")
            rclpy.spin_once(self._node, executor=self._executor, timeout_sec=LOOK)
        return found[0]

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.hardware_id == self.namespace:
                name = status.name.removeprefix(f"{self.namespace}/")
                level = int.from_bytes(status.level, "little")
                self._reports[name] = NodeHealth(name, level, status.message, figures_of(status))


@contextmanager
def rig_requests(namespace: str) -> Iterator[RigRequests]:
    """Join the graph for the duration of requests to a rig.

    Args:
        namespace: of its nodes.

    Raises:
        BadInput: not a valid ROS namespace.
    """
    inner = checked_namespace(namespace)
    with suppress(PermissionError):
        prefer(threads(), PRIORITY)
    with joined() as (node, executor):
        rig = RigRequests(node, executor, inner)
        try:
            yield rig
        finally:
            rig.close()
