"""The dashboard's view of a running graph: signals read in bulk, diagnostics, parameters and services."""

import contextlib
import gc
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from numpy.typing import NDArray
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.srv import AcknowledgeStop
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.dashboard.graph import (
    MAX_NAME,
    Answer,
    NodeHealth,
    RigHealth,
    Tunable,
    Value,
    shortened,
    shortened_figures,
    until_granted,
)
from ehls_ros.dashboard.panels import ELEMENTS, FORCE_REFERENCE, PEAK, POSITION_REFERENCE, RESPONSE, SIGNALS, VALLEY
from ehls_ros.dashboard.window import Peaks, Window
from ehls_ros.errors import BadInput
from ehls_ros.hardware.ownership import node_of
from ehls_ros.hardware.realtime import preferring_what_starts
from ehls_ros.nodes import SUFFIX, codec, controller_of, node_names
from ehls_ros.nodes.control import NAMESPACE
from ehls_ros.nodes.dashboard_rig import RigWatch
from ehls_ros.nodes.graph import GOALS, LOST, REALTIME_PRIORITY
from ehls_ros.nodes.graph_nodes import PLANTS
from ehls_ros.nodes.parameter_requests import checked_namespace
from ehls_ros.nodes.transport import Inbox, message_class
from ehls_ros.recording.alignment import CYCLE, NANOSECONDS, SECONDS
from ehls_ros.recording.cdr import CdrError, decode, flatten
from ehls_ros.recording.topics import (
    CHAMBER_PRESSURES,
    CONTROLLER_STATUS,
    DEPTH,
    FRICTION_ESTIMATE,
    LOADER_STATE,
    OF_GATE,
    PROGRAMME_POINT,
    REFERENCE_TOPICS,
    VALVE_COMMAND,
    Topic,
)
from ehls_ros.recording.typestore import typestore

READ_INTERVAL = 0.05
"""Interval between bulk reads of the messages [s]."""

DISCOVERY_TIMEOUT = 5.0
"""Longest wait for the discovery of a service [s]."""

ANSWER_TIMEOUT = 30.0
"""Longest wait for the answer of a service [s]; real-time nodes leave other threads little time."""

MAX_SILENCE = 3.0
"""Time without diagnostics, which are due every second, after which a node counts as silent [s]."""

MAX_SHOWN_SILENCE = 15.0
"""Time without diagnostics after which a node is no longer shown [s]."""

MAX_SNAPSHOT_SILENCE = 1.0
"""Time without a snapshot after which there is no graph [s].

These three times are counted in passes of the reading thread, so that a stalled dashboard does not time nodes out.
"""

SERVICES = (
    (Trigger, "emergency_stop"),
    (AcknowledgeStop, "acknowledge_stop"),
    (Trigger, "unload"),
    (Trigger, "reset_trips"),
    (SetBool, "enable"),
    (Trigger, "monitor_acknowledge"),
    (Trigger, "programme_stop"),
    (Trigger, "programme_resume"),
    (Trigger, "programme_skip"),
)
"""Services of plant, monitor and programme that the page's buttons call."""

REPORT_DEPTH = 16
"""Queue depth for diagnostics; other publishers' messages may be large."""

MAX_FOREIGN_NODES = 32
"""Maximum number of nodes shown that are not this project's."""

MAX_REPORT_SIZE = 64 * 1024
"""Size of the largest diagnostics message read [B]; one of this project's has about 3 kB."""

MAX_TUNABLES = 200
"""Maximum number of parameters read from a node."""

OWN_NODES = frozenset(node_names())
"""Names that include all of this project's nodes, which are always shown."""

LATE = 1
"""Level of a silent node in a running graph: the machine may be busy."""

SILENT = 3
"""Level of a silent node otherwise, above those of diagnostics."""

CYCLES = 8192
"""Snapshots whose sending time is kept until their command arrives."""

AHEAD = (*REFERENCE_TOPICS.values(), PROGRAMME_POINT)
"""Topics that run ahead of the cycles; their values are shown with the snapshots."""

TOPICS = (*AHEAD, LOADER_STATE, CHAMBER_PRESSURES, VALVE_COMMAND, CONTROLLER_STATUS, FRICTION_ESTIMATE)
"""Topics read; of the others, the snapshots come first, as they set the time base."""


def observer_qos() -> QoSProfile:
    """Return the QoS profile of a reader that loads the loop least: best effort, so it acknowledges nothing."""
    return QoSProfile(
        depth=DEPTH,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )


class _Report(NamedTuple):
    when: float
    at_pass: int
    health: NodeHealth


class _Source:
    """One topic's messages as columns."""

    def __init__(self, node: Any, topic: Topic) -> None:
        self.topic = topic
        self._fields = flatten(typestore().fielddefs, topic.type)
        self._wanted = {CYCLE, SECONDS, NANOSECONDS, *topic.signals}
        self._inbox = Inbox(node, message_class(topic.type), topic.name, observer_qos())

    def take(self) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]] | None:
        """Return all messages that have arrived and their sending times [ns]; None if there are none."""
        messages, sent = [], []
        while (taken := self._inbox.take_raw()) is not None:
            messages.append(taken[0])
            sent.append(taken[1]["source_timestamp"])
        if not messages:
            return None
        try:
            return decode(messages, self._fields, self._wanted), np.array(sent, dtype=np.int64)
        except CdrError:
            # A malformed message of another publisher; the batch is dropped.
            return None

    def destroy(self) -> None:
        self._inbox.destroy()


class Link:
    """A participant that observes the graph and forwards requests."""

    def __init__(self, namespace: str = NAMESPACE) -> None:
        """Join the graph of this process's domain.

        Args:
            namespace: namespace of its nodes; nodes elsewhere are ignored.

        Raises:
            BadInput: not a valid ROS namespace.
        """
        self.namespace = checked_namespace(namespace)
        self.where = f"/{self.namespace} in ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')}"
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.window = Window(tuple(SIGNALS))
        # A receiver thread preempted while it holds a lock would make the sending nodes wait.
        with preferring_what_starts(REALTIME_PRIORITY):
            self._node = rclpy.create_node("dashboard", namespace=f"/{self.namespace}")
        self._lock = threading.Lock()
        self._reports: dict[str, _Report] = {}
        self._ignored_until: dict[str, int] = {}
        self._clients: dict[str, Any] = {}
        # Created in advance: a node drops the answer to a client that it has not discovered yet.
        for kind, service in SERVICES:
            self._client(kind, service)
        self._diagnostics = Inbox(self._node, DiagnosticArray, "/diagnostics", QoSProfile(depth=REPORT_DEPTH), bytes)
        self._sources = [_Source(self._node, topic) for topic in TOPICS]
        self._origin_ns: int | None = None
        self._newest = -1
        self._sent_at = np.zeros(CYCLES, dtype=np.int64)
        self._sent_cycle = np.full(CYCLES, -1, dtype=np.int64)
        # By reference: the cycles of its last rows, and their values.
        self._references = {
            name: (np.full(CYCLES, -1, dtype=np.int64), np.full(CYCLES, np.nan))
            for name in (FORCE_REFERENCE, POSITION_REFERENCE)
        }
        self._peaks = Peaks()
        self._rig = RigWatch(self._node)
        self._arrivals: list[tuple[float, int]] = []
        self._passes = self._last_arrival = 0
        self.period = 0.0
        self._closing = threading.Event()
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._threads = [
            threading.Thread(target=self._read, name="signals"),
            threading.Thread(target=self._serve, name="services"),
        ]
        for thread in self._threads:
            thread.start()

    def abort(self) -> None:
        """Abort every pending request."""
        self._closing.set()

    def close(self) -> None:
        """Leave the graph."""
        self.abort()
        for thread in self._threads:
            thread.join()
        self._executor.remove_node(self._node)
        self._executor.shutdown()
        for source in self._sources:
            source.destroy()
        self._diagnostics.destroy()
        self._rig.destroy()
        self._node.destroy_node()
        # Objects that refer to the middleware must be collected before it shuts down.
        del self._executor, self._sources, self._diagnostics, self._rig, self._clients, self._node
        gc.collect()
        rclpy.try_shutdown()

    def rate(self) -> float:
        """Return the rate of snapshots over about the last second [1/s]; 0 without a graph."""
        with self._lock:
            arrivals = list(self._arrivals)
        if len(arrivals) < 2 or self._passed(self._last_arrival) > MAX_SNAPSHOT_SILENCE:
            return 0.0
        (begin, _), (end, _) = arrivals[0], arrivals[-1]
        return sum(count for _, count in arrivals[1:]) / (end - begin)

    def health(self) -> tuple[NodeHealth, ...]:
        """Return the nodes' diagnostics, sorted by name; a silent node is shown as late while cycles arrive, else as silent."""
        now, level = time.monotonic(), LATE if self.rate() else SILENT
        with self._lock:
            self._reports = {
                name: report for name, report in self._reports.items() if self._passed(report.at_pass) < MAX_SHOWN_SILENCE
            }
            reports = sorted(self._reports.items())
        return tuple(
            health._replace(level=level, message=f"no diagnostics for {now - when:.0f} s")
            if self._passed(at) > MAX_SILENCE
            else health
            for _, (when, at, health) in reports
        )

    def forget(self, nodes: Collection[str]) -> None:
        """Forget some nodes, and ignore messages they have sent before now."""
        with self._lock:
            self._ignored_until |= dict.fromkeys(nodes, time.time_ns())
            self._reports = {name: report for name, report in self._reports.items() if name not in nodes}
            if any(plant in nodes for plant in PLANTS.values()):
                self._arrivals = []

    def tunable_nodes(self) -> tuple[str, ...]:
        """Return the nodes with live parameters, the driving controller first."""
        known = {health.node: health.figures for health in self.health()}
        owner = next((figures[OF_GATE] for figures in known.values() if OF_GATE in figures), "")
        driver = node_of(owner).rpartition("/")[2]
        laws = sorted((law + SUFFIX for law in CONTROLLERS.names()), key=lambda node: node != driver)
        return tuple(node for node in (*laws, *PLANTS.values()) if node in known)

    def laws(self) -> tuple[str, ...]:
        """Return the laws with a running node, the driving one first."""
        return tuple(law for node in self.tunable_nodes() if (law := controller_of(node)) is not None)

    def on_rig(self) -> bool:
        """Return whether the graph may drive a real rig: anything but the simulated rig alone."""
        present = {node for node in self.tunable_nodes() if node in PLANTS.values()}
        return present != {PLANTS["sim"]}

    def parameters(self, node: str) -> tuple[Tunable, ...]:
        """Return a node's live parameters; empty if it does not answer."""
        listed = self.call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        if listed is None:
            return ()
        names = [name for name in listed.result.names[:MAX_TUNABLES] if name == shortened(name, MAX_NAME)]
        described = self.call(DescribeParameters, f"{node}/describe_parameters", DescribeParameters.Request(names=names))
        got = self.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
        if described is None or got is None:
            return ()
        values = map(parameter_value_to_python, got.values)
        return tuple(
            _tunable(descriptor, value)
            # Another process under the node's name may return fewer.
            for descriptor, value in zip(described.descriptors, values, strict=False)
            # rclpy's own parameters have no description.
            if descriptor.description and not descriptor.read_only and isinstance(value, float | int | str)
        )

    def set_parameter(self, node: str, name: str, value: Value) -> Answer:
        """Set a node's parameter; the answer carries the node's reason if it refuses."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        response = self.call(SetParameters, f"{node}/set_parameters", request)
        if response is None or not response.results:
            return Answer(done=False, message=f"{node} does not answer")
        result = response.results[0]
        reason = shortened(result.reason) or f"{node} refused {name} without giving a reason"
        return Answer(result.successful, f"{name} is now {value}" if result.successful else reason)

    def set_parameters(self, node: str, values: Mapping[str, Value]) -> Answer:
        """Set several parameters of a node at once, all or none; the answer carries the node's reason if it refuses."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        response = self.call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
        if response is None:
            return Answer(done=False, message=f"{node} does not answer")
        if not response.result.successful:
            return Answer(done=False, message=shortened(response.result.reason) or f"{node} refused without giving a reason")
        return Answer(done=True, message=", ".join(f"{name} is now {value}" for name, value in values.items()))

    def emergency_stop(self) -> Answer:
        """Cut the command."""
        answer = self._request(Trigger, "emergency_stop", Trigger.Request())
        return answer._replace(message=f"emergency stop {_outcome(answer)}: the valve is closed") if answer.done else answer

    def acknowledge_stop(self) -> Answer:
        """Acknowledge the emergency stop that the gate reports."""
        stop = next((node.figures["stop"] for node in self.health() if node.figures.get("stop")), "")
        return self._gate(AcknowledgeStop, "acknowledge_stop", AcknowledgeStop.Request(stop=stop))

    def rig_health(self) -> RigHealth | None:
        """Return the monitor's report on the rig; None without a monitor."""
        return self._rig.health()

    def acknowledge_changes(self) -> Answer:
        """Acknowledge the changes found by the monitor on behalf of an operator."""
        return self._request(Trigger, "monitor_acknowledge", Trigger.Request(), "monitor")

    def unload(self) -> Answer:
        """Let the load pressure decay, then close the valve."""
        return self._gate(Trigger, "unload", Trigger.Request())

    def reset_trips(self) -> Answer:
        """Reset the gate's latched trips."""
        return self._gate(Trigger, "reset_trips", Trigger.Request())

    def enable(self) -> Answer:
        """Let commands through again."""
        return self._gate(SetBool, "enable", SetBool.Request(data=True))

    def reset_and_enable(self) -> Answer:
        """Reset the gate's latched trips and let commands through again."""
        answer = self.reset_trips()
        return self.enable() if answer.done else answer

    def programme(self, request: str) -> Answer:
        """Stop, resume or skip a block of the running programme: ``stop``, ``resume`` or ``skip``."""
        return self._request(Trigger, f"programme_{request}", Trigger.Request(), "programme")

    def is_up(self, node: str) -> bool:
        """Return whether a lifecycle node is ready for requests."""
        return bool(self._client(ChangeState, f"{node}/change_state").service_is_ready())

    def duplicates(self, nodes: Iterable[str]) -> list[str]:
        """Return the nodes whose name occurs more than once in the graph."""
        names = [(f"/{self.namespace}", node) for node in nodes]
        present = Counter((space, name) for name, space in self._node.get_node_names_and_namespaces())
        return [name for space, name in names if present[space, name] > 1]

    def change_state(self, node: str, transition: int, patience: float, hopeless: Callable[[], bool]) -> Answer:
        """Request a lifecycle transition, until it is answered, ``patience`` [s] is over or ``hopeless`` holds.

        A request can get lost, for example to a node that has just been stopped but is still listed. So an unresponsive node is
        queried for its state, which it returns when it is up and between transitions. If the transition has not happened, the
        request is repeated.
        """
        request = ChangeState.Request(transition=Transition(id=transition))
        deadline = time.monotonic() + patience
        ask = True
        while (left := deadline - time.monotonic()) > 0.0 and not (self._closing.is_set() or hopeless()):
            patient = min(left, LOST)
            if ask:
                response = self.call(ChangeState, f"{node}/change_state", request, left, patient, hopeless)
                if response is not None:
                    return Answer(response.success, "" if response.success else f"{node} refused the transition")
            state = self.call(GetState, f"{node}/get_state", GetState.Request(), patient, patient, hopeless)
            ask = state is not None
            if state is not None and state.current_state.id == GOALS[transition]:
                return Answer(done=True, message="")
        return Answer(done=False, message=f"{node} did not answer in {patience:.0f} s")

    def text_parameters(self, node: str, names: Sequence[str]) -> list[str]:
        """Return text parameters of a node.

        Raises:
            BadInput: it does not answer.
        """
        response = self.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=list(names)))
        if response is None or len(response.values) != len(names):
            raise BadInput(f"{node} does not answer", "graph", f"its parameters {', '.join(names)}")
        return [str(value.string_value) for value in response.values]

    def call(
        self,
        kind: Any,
        service: str,
        request: Any,
        discovery_timeout: float = DISCOVERY_TIMEOUT,
        answer_timeout: float = ANSWER_TIMEOUT,
        hopeless: Callable[[], bool] = lambda: False,
    ) -> Any:
        """Call a service and wait for its answer; None after a timeout, when the link closes, or if the wait is aborted.

        Args:
            kind: service type.
            service: service name.
            request: the request.
            discovery_timeout: longest wait for discovery [s].
            answer_timeout: longest wait for the answer from then on [s]; the wait ends early if the service disappears.
            hopeless: returns whether the wait should be aborted.
        """
        client = self._client(kind, service)
        deadline = time.monotonic() + discovery_timeout

        def is_over() -> bool:
            return time.monotonic() > deadline or self._closing.is_set() or hopeless()

        while not client.service_is_ready():
            if is_over():
                return None
            self._closing.wait(READ_INTERVAL)
        deadline = time.monotonic() + answer_timeout
        arrived = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: arrived.set())
        while not arrived.wait(READ_INTERVAL):
            if is_over() or not client.service_is_ready():
                client.remove_pending_request(future)
                return None
        return future.result()

    def _gate(self, kind: Any, service: str, request: Any) -> Answer:
        """Send a request to the safety gate, repeatedly while it is refused for the moment."""
        answer = until_granted(lambda: self._request(kind, service, request), self._closing.wait)
        return answer._replace(message=_outcome(answer)) if answer.done else answer

    def _request(self, kind: Any, service: str, request: Any, server: str = "plant") -> Answer:
        response = self.call(kind, service, request)
        if response is None:
            return Answer(done=False, message=f"{service}: no {server} node answers")
        return Answer(response.success, shortened(response.message))

    def _client(self, kind: Any, service: str) -> Any:
        with self._lock:
            if service not in self._clients:
                self._clients[service] = self._node.create_client(kind, service)
            return self._clients[service]

    def _serve(self) -> None:
        while not self._closing.is_set():
            # Another process may answer with invalid UTF-8.
            with contextlib.suppress(UnicodeDecodeError):
                self._executor.spin_once(timeout_sec=0.2)

    def _passed(self, since: int) -> float:
        """Return the time the reading thread has spent since one of its passes [s]."""
        return READ_INTERVAL * (self._passes - since)

    def _read_diagnostics(self) -> None:
        """Read the nodes' diagnostics."""
        while (taken := self._diagnostics.take_raw()) is not None:
            report = taken[0]
            if len(report) > MAX_REPORT_SIZE:
                continue
            # Another publisher's message may hold invalid UTF-8.
            with contextlib.suppress(UnicodeDecodeError):
                self._register_diagnostics(deserialize_message(report, DiagnosticArray), taken[1]["source_timestamp"])

    def _register_diagnostics(self, array: DiagnosticArray, sent_ns: int) -> None:
        now = time.monotonic()
        with self._lock:
            for status in array.status:
                name = shortened(status.name.removeprefix(f"{self.namespace}/"), MAX_NAME)
                if status.hardware_id != self.namespace or sent_ns < self._ignored_until.get(name, 0):
                    continue
                if (
                    name not in OWN_NODES
                    and name not in self._reports
                    and len(self._reports.keys() - OWN_NODES) == MAX_FOREIGN_NODES
                ):
                    continue
                values_by_name = shortened_figures((pair.key, pair.value) for pair in status.values)
                level = int.from_bytes(status.level, "little")
                health = NodeHealth(name, min(level, SILENT), shortened(status.message), values_by_name)
                self._reports[name] = _Report(now, self._passes, health)

    def _read(self) -> None:
        """Read messages in bulk until the link closes."""
        while not self._closing.wait(READ_INTERVAL):
            for source in self._sources:
                taken = source.take()
                if taken is not None:
                    self._process(source.topic, *taken)
            self._read_diagnostics()
            self._rig.take()
            self._passes += 1

    def _process(self, topic: Topic, columns: Mapping[str, NDArray[Any]], sent_ns: NDArray[np.int64]) -> None:
        cycle = columns[CYCLE].astype(np.int64)
        stamp_ns = columns[SECONDS].astype(np.int64) * codec.NANOSECONDS + columns[NANOSECONDS]
        values = _by_signal(topic, columns)
        if topic is LOADER_STATE:
            self._process_snapshots(cycle, stamp_ns, sent_ns)
            values[PEAK], values[VALLEY] = self._peaks.of(cycle, values["force_n"])
            for name, (cycles, ahead) in self._references.items():
                values[name] = np.where(cycles[cycle % CYCLES] == cycle, ahead[cycle % CYCLES], np.nan)
        if topic is PROGRAMME_POINT:
            self._peaks.note(cycle, columns)
        for name in values.keys() & self._references.keys() if topic in AHEAD else ():
            cycles, ahead = self._references[name]
            cycles[cycle % CYCLES], ahead[cycle % CYCLES] = cycle, values[name]
        if topic in AHEAD:
            return
        if self._origin_ns is None:
            return
        if topic is VALVE_COMMAND:
            response_ns = sent_ns - self._sent_at[cycle % CYCLES]
            # A node in the plant's process has answered before either message is sent, and its command is sent first.
            values[RESPONSE] = 1e-3 * self._since_snapshot(cycle, np.where(response_ns >= 0, response_ns, np.nan))
        time_s = 1e-9 * (stamp_ns - self._origin_ns)
        # Drop samples of a previous graph, or too far ahead of the cycles.
        fits = (time_s >= 0.0) & (cycle <= self._newest + DEPTH) & np.isfinite(time_s)
        order = np.argsort(time_s[fits], kind="stable")
        self.window.add(time_s[fits][order], {name: column[fits][order] for name, column in values.items()})

    def _process_snapshots(self, cycle: NDArray[np.int64], stamp_ns: NDArray[np.int64], sent_ns: NDArray[np.int64]) -> None:
        now = time.monotonic()
        with self._lock:
            self._arrivals.append((now, len(cycle)))
            recent = [arrival for arrival in self._arrivals if now - arrival[0] < MAX_SNAPSHOT_SILENCE]
            self._arrivals = recent if len(recent) > 1 else self._arrivals[-2:]
            self._last_arrival = self._passes
        apart = cycle[-1] - cycle[0]
        if apart > 0:
            self.period = 1e-9 * float(stamp_ns[-1] - stamp_ns[0]) / float(apart)
        if cycle[-1] < self._newest or self._origin_ns is None:
            # The graph restarted: its time is zero at cycle 0.
            if apart <= 0:
                return
            self._origin_ns = int(stamp_ns[0] - cycle[0] * (stamp_ns[-1] - stamp_ns[0]) // apart)
            self.window.restart()
        self._newest = int(cycle[-1])
        self._sent_at[cycle % CYCLES] = sent_ns
        self._sent_cycle[cycle % CYCLES] = cycle

    def _since_snapshot(self, cycle: NDArray[np.int64], values: NDArray[Any]) -> NDArray[np.float64]:
        """Return the values, with NaN where the cycle's snapshot was not received."""
        return np.where(self._sent_cycle[cycle % CYCLES] == cycle, values, np.nan)


def _outcome(answer: Answer) -> str:
    """Return a gate's answer without the services to call next, for which the page has buttons."""
    return answer.message.partition(";")[0]


def _tunable(descriptor: ParameterDescriptor, value: Any) -> Tunable:
    limits: list[float | None] = [None, None]
    for ranges in (descriptor.floating_point_range, descriptor.integer_range):
        if ranges:
            limits = [ranges[0].from_value, ranges[0].to_value]
    shown = shortened(value) if isinstance(value, str) else value
    return Tunable(descriptor.name, shown, shortened(descriptor.description), *limits)


def _by_signal(topic: Topic, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[np.float64]]:
    values: dict[str, NDArray[np.float64]] = {}
    for field, signal in topic.signals.items():
        column = columns[field].astype(float)
        if column.ndim == 1:
            values[signal] = column
        else:
            values |= {f"{signal}[{i}]": column[:, i] for i in range(min(ELEMENTS, column.shape[1]))}
    return values
