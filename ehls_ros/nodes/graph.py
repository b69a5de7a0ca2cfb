"""One experiment on the node graph: start the nodes, take them through their lifecycle, record, shut down.

Replaces ``launch/ehls.launch.py`` without the use of ``launch``, and ends after the last cycle.
"""

import gc
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.errors import WorkFailed
from ehls_ros.experiments.run_failure import NodeFailed
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import Spec, signal_kind, uses_actuator
from ehls_ros.hardware.realtime import preferring_what_starts
from ehls_ros.nodes.control import CLOCK_TOPIC, NAMESPACE, PARENT
from ehls_ros.nodes.diagnostics import figures_of
from ehls_ros.nodes.graph_nodes import (
    BACKGROUND,
    COMPOSED,
    LOCKSTEP,
    PLANTS,
    PLUS,
    PROGRAMME,
    REALTIME,
    RECORDER,
    nodes_of,
    processes_of,
    reference_node,
)
from ehls_ros.nodes.operator_guide import OperatorGuide
from ehls_ros.process import Stopping
from ehls_ros.recording.bag_reader import is_closed
from ehls_ros.recording.topics import (
    ACTUATOR_TOPICS,
    CHAMBER_PRESSURES,
    CYCLE_TOPICS,
    FRICTION_ESTIMATE,
    PROGRAMME_POINT,
    REFERENCE_TOPICS,
)
from ehls_ros.recording.topics import DISTURBANCE as DISTURBANCE_TOPIC

UP_TIME = 600.0
"""Longest time a node may take to start and compile [s]."""

LOST = 5.0
"""Time without an answer after which a requested transition may have been lost [s]."""

GOALS = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
}
"""State of a node after each transition."""

SHUTDOWN_TIME = 60.0
"""Time that a node has to exit after SIGINT before it is killed [s]."""

ENABLE_TIME = 60.0
"""Longest wait for the gate of a rig to open [s]."""

ASK_AGAIN = 0.1
"""Retry interval while the gate stays closed [s]: each request takes time that the cycles need."""

REALTIME_PRIORITY = 10
"""SCHED_FIFO priority of the nodes in realtime, where the user may set it."""

NICE = 10
"""Nice value of the background nodes."""

LONGEST_LINE = 4096
"""Maximum number of bytes read from a log to find its last line."""

DOMAINS = range(1, 102)
"""Domains whose ports lie below Linux's ephemeral range."""


class Running(NamedTuple):
    """One node's process; nodes that share a process have the same one."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path


class Plant(NamedTuple):
    """The plant of a graph: the simulated rig or a bridge to a real one.

    Attributes:
        kind: key of :data:`~ehls_ros.nodes.graph_nodes.PLANTS`.
        bridge: bridge file; None: UDP to this host.
        fmu: FMU in place of the simulator.
        plant_map: map of its variables.
    """

    kind: str = "sim"
    bridge: Path | None = None
    fmu: Path | None = None
    plant_map: Path | None = None

    @property
    def node(self) -> str:
        """The plant's executable."""
        return PLANTS[self.kind]


SIMULATED = Plant()


def expected_topics(spec: Spec, plant: Plant) -> list[str]:
    """Return the control-path topics that an experiment's nodes publish for certain."""
    law = CONTROLLERS.load(spec.controller.name)
    absent = [topic for follows, topic in REFERENCE_TOPICS.items() if follows != law.FOLLOWS]
    used = signal_kind(spec.disturbance.name) if uses_actuator(spec) else None
    absent += [topic for kind, topic in ACTUATOR_TOPICS.items() if kind != used]
    if reference_node(spec) != PROGRAMME:
        absent.append(PROGRAMME_POINT)
    if not law.FRICTION:
        absent.append(FRICTION_ESTIMATE)
    if plant.kind == "bridge":
        absent.append(DISTURBANCE_TOPIC)
    if plant.kind != "sim" or not spec.rig.cylinder.law.CHAMBERS:
        # A bridge has them only where both are wired.
        absent.append(CHAMBER_PRESSURES)
    return [topic.name for topic in CYCLE_TOPICS if topic not in absent]


def run_graph(
    spec: Spec,
    folder: RunFolder,
    timing: str,
    storage: str,
    progress: Callable[[int, int], None] | None = None,
    plant: Plant = SIMULATED,
    *,
    compose: bool = False,
    end_on_trip: bool = True,
    attended: bool = True,
    continued: Path | None = None,
    until_finished: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> float:
    """Run an experiment over DDS, with one process per node, or with the nodes of the cycle in one process.

    Unless ``end_on_trip``, the graph stays up after an emergency stop or a trip, until an operator has enabled the rig again
    and the remaining cycles are run, or until an interrupt.

    Args:
        spec: the experiment, already written to the run folder.
        folder: run folder for the bag and the nodes' logs.
        timing: lockstep or realtime.
        storage: format of the bag.
        progress: called repeatedly with the number of finished cycles and the total.
        plant: simulated rig or bridge.
        compose: whether the nodes of the cycle are one process.
        end_on_trip: whether an emergency stop or a trip ends the run.
        attended: whether an operator may be present; otherwise a trip without an emergency stop ends the run.
        continued: folder of an earlier run whose programme is continued, in its log and state; None: the programme begins.
        until_finished: whether the run ends with its programme, whatever the number of cycles.
        say: prints a line for the operator.

    Returns:
        Wall time from the plant's first to its last cycle [s].

    Raises:
        NodeFailed: the run is complete and its bag closed, but a node exited with an error.
        WorkFailed: a node did not come up, or died.
    """
    environment = graph_environment()
    os.environ.update({key: environment[key] for key in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")})
    folder.logs.mkdir()
    parameters = node_parameters(spec, plant, folder, timing, storage)
    if until_finished:
        parameters[plant.node]["cycles"] = parameters[RECORDER]["cycles"] = 0
    if continued is not None:
        parameters[PROGRAMME]["folder"] = str(continued.resolve())
    say(f"rig of this run: {OperatorGuide.prefix()}ehls rig status")
    guide = OperatorGuide(say, end_on_trip=end_on_trip, attended=attended, has_programme=PROGRAMME in parameters)
    processes = processes_of(list(parameters), compose=compose)
    # The nodes end with this process, even when it is interrupted.
    with _interrupts_noted() as interrupted, node_processes(processes, parameters, folder.logs, environment) as running:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        try:
            conductor = Conductor(
                running, plant, timing, interrupted, guide, resume=continued is not None, until_finished=until_finished
            )
            wall = conduct(conductor, spec.cycles, progress)
        finally:
            # Objects that refer to the middleware must be collected before it shuts down.
            gc.collect()
            rclpy.try_shutdown()
    if not is_closed(folder.bag):
        log = folder.logs / f"{RECORDER}.log"
        raise WorkFailed(f"{RECORDER} did not close the bag: see {log}; `ehls recover {folder.bag}` restores its contents")
    for node in running:
        if node.process.returncode != 0:
            raise NodeFailed(f"{node.name} ended with exit code {node.process.returncode}: {last_line(node.log)}", wall)
    return wall


def graph_environment() -> dict[str, str]:
    """Return the environment for the nodes: this host only, and a free domain unless ROS_DOMAIN_ID is set."""
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(Path(__file__).with_name("fastdds.xml")))
    # No loop has matrices large enough to need a second BLAS thread, which would reserve 70 MiB of buffers.
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
    environment.setdefault("PYTHONUNBUFFERED", "1")
    environment.setdefault("PYTHONFAULTHANDLER", "1")
    if "ROS_DOMAIN_ID" not in environment:
        environment["ROS_DOMAIN_ID"] = str(free_domain())
    return environment


def free_domain() -> int:
    """Return a domain that no participant on this host uses; each process starts its search at a different one."""
    for offset in range(len(DOMAINS)):
        domain = DOMAINS[(os.getpid() + offset) % len(DOMAINS)]
        if not _is_used(domain):
            return domain
    raise WorkFailed("all ROS domains from 1 to 101 are in use on this host: stop other graphs or set ROS_DOMAIN_ID")


def domains_in_use() -> list[int]:
    """Return the domains from 0 to 101 with participants on this host."""
    return [domain for domain in (0, *DOMAINS) if _is_used(domain)]


def _is_used(domain: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # Discovery port of the domain's first participant, by the RTPS port mapping.
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return True
    return False


def node_parameters(spec: Spec, plant: Plant, folder: RunFolder, timing: str, storage: str) -> dict[str, dict[str, Any]]:
    """Return the parameters by node, in order of activation."""
    common = {"spec": str(folder.spec.resolve()), "timing": timing, "autostart": False}
    parameters: dict[str, dict[str, Any]] = {name: dict(common) for name in nodes_of(spec, plant.kind)}
    if timing == REALTIME:
        for own in parameters.values():
            own["priority"] = REALTIME_PRIORITY
    parameters[plant.node]["cycles"] = spec.cycles
    if plant.bridge is not None:
        parameters[plant.node]["bridge"] = str(plant.bridge.resolve())
    if plant.fmu is not None:
        parameters[plant.node]["plant_fmu"] = str(plant.fmu.resolve())
    if plant.plant_map is not None:
        parameters[plant.node]["plant_map"] = str(plant.plant_map.resolve())
    if PROGRAMME in parameters:
        parameters[PROGRAMME]["folder"] = str(folder.path.resolve())
    parameters[RECORDER] |= {
        "bag": str(folder.bag.resolve()),
        "storage": storage,
        "expected": ",".join(expected_topics(spec, plant)),
        "cycles": spec.cycles,
    }
    return parameters


@contextmanager
def _interrupts_noted() -> Iterator[Stopping]:
    """Record SIGINT and SIGTERM; the conductor checks for them between two steps.

    An exception raised by the handler could land in a destructor or callback, which would swallow it.
    """
    noted = Stopping()

    def note(number: int, frame: FrameType | None) -> None:
        noted.set()

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def node_processes(
    processes: Sequence[str],
    parameters: Mapping[str, Mapping[str, Any]],
    logs: Path,
    environment: Mapping[str, str],
    namespace: str = NAMESPACE,
) -> Iterator[list[Running]]:
    """Start the nodes; on exit, stop them with SIGINT and kill those that remain. If this process is killed, they end too.

    Args:
        processes: names of nodes; nodes of one process are joined by :data:`~ehls_ros.nodes.graph_nodes.PLUS`.
        parameters: of each node.
        logs: folder for the output of the processes, and for their parameters.
        environment: of the processes.
        namespace: of the nodes.
    """
    running: list[Running] = []
    environment = {**environment, PARENT: str(os.getpid())}
    try:
        for process_name in processes:
            names = process_name.split(PLUS)
            name = COMPOSED if len(names) > 1 else process_name
            file = logs / f"{name}.yaml"
            own = {f"/**/{node}": {"ros__parameters": dict(parameters[node])} for node in names}
            file.write_text(yaml.safe_dump(own), encoding="utf-8")
            arguments = ["--ros-args", "-r", f"__ns:=/{namespace}", "--params-file", str(file)]
            # In lockstep, each rig has a separate time.
            arguments += ["-r", f"{CLOCK_TOPIC}:=/{namespace}{CLOCK_TOPIC}"] if namespace != NAMESPACE else []
            module = [f"ehls_ros.nodes.{name}", *(names if name == COMPOSED else [])]
            command = [sys.executable, "-m", *module, *arguments]
            log = logs / f"{name}.log"
            with log.open("wb") as output:
                # In a separate session, so that Ctrl-C reaches only this process, which stops the nodes in order.
                process = subprocess.Popen(
                    command, stdout=output, stderr=subprocess.STDOUT, env=environment, start_new_session=True
                )
            running += [Running(node, process, log) for node in names]
        yield running
    finally:
        for node in running:
            if node.process.poll() is None:
                node.process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + SHUTDOWN_TIME
        for node in running:
            try:
                node.process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                node.process.kill()
                node.process.wait()


def share_processors(running: list[Running], timing: str) -> None:
    """Give plant, estimator and controller priority over the background nodes.

    These three work in turn, never at once. In lockstep they share one processor: a hand-over between processors has to wake
    an idle one, which takes longer than the work itself. In realtime they may use all processors, since latency matters more
    than throughput.
    """
    processors = sorted(os.sched_getaffinity(0))
    for node in running:
        background = all(other.name in BACKGROUND for other in running if other.process is node.process)
        for thread in (int(task.name) for task in Path(f"/proc/{node.process.pid}/task").iterdir()):
            if background:
                os.setpriority(os.PRIO_PROCESS, thread, NICE)
            if timing == LOCKSTEP and len(processors) > 1:
                os.sched_setaffinity(thread, processors[:-1] if background else processors[-1:])


def conduct(conductor: "Conductor", cycles: int, progress: Callable[[int, int], None] | None) -> float:
    """Take the nodes through the experiment and leave the graph; return the wall time of the cycles [s]."""
    try:
        return conductor.run(cycles, progress)
    finally:
        conductor.close()


class Conductor:
    """Takes running nodes through their lifecycle and watches them."""

    def __init__(
        self,
        running: list[Running],
        plant: Plant,
        timing: str,
        interrupted: Stopping,
        guide: OperatorGuide,
        *,
        resume: bool = False,
        until_finished: bool = False,
    ) -> None:
        """Join the graph.

        Args:
            running: the processes of the nodes.
            plant: the plant.
            timing: lockstep or realtime.
            interrupted: once set, the work ends with KeyboardInterrupt.
            guide: prints what the operator has to do.
            resume: whether the programme is resumed at the start.
            until_finished: whether the work ends with the programme.
        """
        self._interrupted = interrupted
        self._guide = guide
        self._resume, self._until_finished = resume, until_finished
        self._finished = False
        self._running = running
        self._plant = plant
        self._timing = timing
        # A receiver thread preempted while it holds a lock would make the sending nodes wait.
        with preferring_what_starts(REALTIME_PRIORITY) if timing == REALTIME else nullcontext():
            self._node = Node("conductor", namespace=NAMESPACE)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._clients = {node.name: self._node.create_client(ChangeState, f"{node.name}/change_state") for node in running}
        self._states = {node.name: self._node.create_client(GetState, f"{node.name}/get_state") for node in running}
        self._ended = False
        self._failure = ""
        self._cycle = 0
        self._node.create_subscription(TransitionEvent, f"{plant.node}/transition_event", self._on_transition, 10)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def run(self, cycles: int, progress: Callable[[int, int], None] | None) -> float:
        """Configure all nodes in parallel, activate them in order, wait for the plant's last cycle, close the bag.

        Returns:
            Wall time of the cycles [s].
        """
        configuring = [self._transition(node, Transition.TRANSITION_CONFIGURE) for node in self._running]
        for done in configuring:
            done()
        share_processors(self._running, self._timing)
        start = time.perf_counter()
        for node in self._running:
            start = time.perf_counter()
            self._transition(node, Transition.TRANSITION_ACTIVATE)()
        if self._plant.kind == "bridge":
            self._enable()
        if self._resume:
            self._resume_programme()
        state = self._state_of(self._plant.node)
        while not self._ended and not self._failure:
            self._spin()
            # The event may get lost.
            self._ended |= state() == GOALS[Transition.TRANSITION_DEACTIVATE]
            if self._finished and self._until_finished:
                plant = next(node for node in self._running if node.name == self._plant.node)
                self._transition(plant, Transition.TRANSITION_DEACTIVATE)()
                self._ended = True
            if progress is not None:
                progress(self._cycle, cycles)
        wall = time.perf_counter() - start
        recorder = next(node for node in self._running if node.name == RECORDER)
        self._transition(recorder, Transition.TRANSITION_DEACTIVATE)()
        if self._failure:
            raise WorkFailed(f"{self._failure}; what was recorded until then is kept")
        return wall

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.05)
        if self._interrupted.is_set():
            raise KeyboardInterrupt
        for node in self._running:
            if node.process.poll() is not None:
                raise WorkFailed(f"{node.name} ended with exit code {node.process.returncode}: {last_line(node.log)}")

    def _transition(self, node: Running, transition: int) -> Callable[[], None]:
        """Request a transition and return a function that waits for its result."""
        client = self._clients[node.name]
        deadline = time.monotonic() + UP_TIME
        while not client.service_is_ready():
            self._spin()
            if time.monotonic() > deadline:
                raise WorkFailed(f"{node.name} did not come up in {UP_TIME:.0f} s: see {node.log}")
        future = client.call_async(ChangeState.Request(transition=Transition(id=transition)))

        def wait() -> None:
            state = self._state_of(node.name)
            while not future.done():
                self._spin()
                if time.monotonic() > deadline:
                    raise WorkFailed(f"{node.name} did not answer in {UP_TIME:.0f} s: see {node.log}")
                # The middleware may lose the answer; the node's state, queried between transitions, replaces it.
                if state() == GOALS[transition]:
                    return
            if not future.result().success:
                raise WorkFailed(f"{node.name} refused the transition: {last_line(node.log)}")

        return wait

    def _state_of(self, name: str) -> Callable[[], int | None]:
        """Return a function that polls a node's state at intervals and returns the answer to its last request."""
        answer: Any = None
        asked = time.monotonic()

        def state() -> int | None:
            nonlocal answer, asked
            found = answer.result().current_state.id if answer is not None and answer.done() else None
            if time.monotonic() - asked > LOST:
                answer, asked = self._states[name].call_async(GetState.Request()), time.monotonic()
            return found

        return state

    def _enable(self) -> None:
        """Open the rig's gate as soon as it permits; after a trip that is left to the operator."""
        refusal = self._ask_until_granted(SetBool, "enable", SetBool.Request(data=True))
        if refusal:
            raise WorkFailed(f"the rig's safety gate does not open: {refusal}")

    def _resume_programme(self) -> None:
        """Resume the programme of an earlier run, as soon as it has determined where it stands."""
        refusal = self._ask_until_granted(Trigger, "programme_resume", Trigger.Request(), ("the programme is not stopped",))
        if refusal:
            raise WorkFailed(f"the programme does not resume: {refusal}")

    def _ask_until_granted(self, kind: Any, service: str, request: Any, granted: tuple[str, ...] = ()) -> str:
        """Repeat a request until it is granted; return the last refusal, or an empty string.

        Args:
            kind: type of the service.
            service: its name.
            request: the request.
            granted: refusals of a request that was granted before.
        """
        client = self._node.create_client(kind, service)
        deadline = time.monotonic() + ENABLE_TIME
        refusal, ask = "the service did not come up", 0.0
        # A plant that has run all its cycles grants nothing.
        while time.monotonic() < deadline and not (self._ended or self._failure or self._guide.has_tripped):
            self._spin()
            if not client.service_is_ready() or time.monotonic() < ask:
                continue
            future = client.call_async(request)
            # The answer may get lost; the request may be granted twice.
            again = min(deadline, time.monotonic() + LOST)
            while not future.done() and time.monotonic() < again:
                self._spin()
            if future.done() and (future.result().success or future.result().message in granted):
                return ""
            refusal, ask = future.result().message if future.done() else "no answer", time.monotonic() + ASK_AGAIN
        return "" if self._guide.has_tripped or self._failure else refusal

    def _on_transition(self, event: TransitionEvent) -> None:
        self._ended |= (event.start_state.label, event.goal_state.label) == ("deactivating", "inactive")

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.name not in (self._plant.node, RECORDER, PROGRAMME):
                continue
            figures = figures_of(status)
            if status.name == PROGRAMME:
                self._finished = figures.get("programme_state") == "finished"
                continue
            is_error, is_trip = status.level == DiagnosticStatus.ERROR, False
            if status.name == self._plant.node:
                self._cycle = int(figures.get("cycle", self._cycle)) - int(figures.get("closed_cycles", 0))
                self._guide.follow(figures)
                # A simulator or a device that has failed is not a trip, even if the gate has tripped, too.
                is_trip = self._guide.tripped and f"{figures.get('state')}, tripped by" in status.message
            if is_error and (not is_trip or self._guide.ends_run):
                self._failure = f"{status.name}: {status.message}"


def last_line(log: Path) -> str:
    """Return the last line of a node's log, and where the log is."""
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - LONGEST_LINE))
        lines = file.read().decode("utf-8", errors="replace").strip().splitlines()
    return f"{lines[-1]} (in {log})" if lines else f"see {log}"
