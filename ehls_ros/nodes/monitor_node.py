"""`monitor_node`: monitors the running rig and reports changes of its model since the healthy baseline."""

import gc
import math
import subprocess
import sys
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

import numpy as np
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ehls_msgs.msg import (
    ModelChange,
    ModelHealth,
    TrackedCoefficient,
)
from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.diagnosis.record import USED
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.accepted_rig import accepted_model, write_accepted
from ehls_ros.experiments.monitoring.cycle_assembly import LOCKSTEP_MAX_WAIT, MAX_WAIT, CycleAssembler
from ehls_ros.experiments.monitoring.examination import ProcessExaminer
from ehls_ros.experiments.monitoring.flight_recorder import Flight, FlightRecorder
from ehls_ros.experiments.monitoring.health import DebouncedSummary, Event, FoundChange, Health, State, Summary, today
from ehls_ros.experiments.monitoring.memory import UNUSABLE, Memory, SavedMonitor
from ehls_ros.experiments.monitoring.monitor import Monitor
from ehls_ros.experiments.monitoring.monitor import Parameters as MonitoringParameters
from ehls_ros.experiments.monitoring.trends import MAX_HISTORY
from ehls_ros.experiments.state_files.access import FolderLock, NotWritten
from ehls_ros.experiments.state_files.kinds import LEARNS_ANEW
from ehls_ros.experiments.state_files.state_file import Origin
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.hardware.realtime import release_freed_memory, trim_memory
from ehls_ros.nodes.control import NAMESPACE, ControlNode
from ehls_ros.nodes.diagnostics import OK, WARN
from ehls_ros.nodes.frames import loader_frame
from ehls_ros.nodes.monitored_topics import BENEFIT_TIME, InformedControllers, MonitoredTopics
from ehls_ros.nodes.parameters import declare, values_of
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.telemetry import time_of
from ehls_ros.nodes.transport import control_qos
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.process import give_way
from ehls_ros.recording.topics import (
    MODEL_HEALTH,
)
from ehls_ros.schema import quantity, text
from ehls_ros.trajectory import Trajectory

READ_INTERVAL = 0.1
"""Interval between bulk reads of the messages [s]; the middleware stores them meanwhile."""

PUBLISH_INTERVAL = 2.5
"""Shortest time between two messages if no event occurs [s]."""

MEMORY_RELEASE_INTERVAL = 60.0
"""Time between two releases of free memory [s]; no cycle waits for this loop."""

MAX_SILENCE = 2.0
"""Longest time without snapshots; beyond it, the state is idle [s]."""

TRIP_DELAY = 0.5
"""Time after the report of a trip by which the samples before it have arrived [s]."""

ACCEPTED = "rig_accepted.yaml"
"""File of the rig with the changes that an operator has accepted, in the monitor's folder."""

MAX_PENDING_FLIGHTS = 2
"""Maximum number of trips waiting to be written; repeated trips add no information."""

MAX_CHANGES = 50
"""Maximum number of changes published, the newest ones; the memory has all."""

HOUR = 3600.0

UNKNOWN = Estimate(math.nan, math.nan, "")


class Parameters(NamedTuple):
    """Baseline recordings, memory folder and flight recorder of the monitor."""

    baseline: Annotated[
        str, text("recordings of the healthy rig, separated by commas; empty: the rig file and the first minutes")
    ] = ""
    folder: Annotated[
        str, text("folder of memory and flight recorder; empty: runs/monitor, with the namespace of another rig")
    ] = ""
    flights: Annotated[int, quantity("1", "gate trips kept by the flight recorder; 0: none", minimum=0, maximum=1000)] = 10
    flight_size: Annotated[float, quantity("MB", "size of all of them together", minimum=1.0)] = 500.0
    flight_time: Annotated[float, quantity("s", "time before a trip that is kept", minimum=1.0, maximum=600.0)] = 60.0


class MonitorNode(ControlNode):
    """Monitor of a running graph. It reads like the recorder: no cycle waits for it, and it blocks no sender."""

    answers = False
    background = True
    announces = False

    def __init__(self) -> None:
        """Declare the parameters and the services."""
        super().__init__("monitor_node")
        declare(self, MonitoringParameters, live=False)
        declare(self, Parameters, live=False)
        self.monitoring_parameters = values_of(self, MonitoringParameters, self.get_name())
        self.settings = values_of(self, Parameters, self.get_name())
        self.requests = deque[str]()
        self.published_health: Health | None = None
        self.create_service(Trigger, "monitor_acknowledge", self._on_acknowledge)
        self.create_service(Trigger, "monitor_accept", self._on_accept)
        self.create_service(Trigger, "monitor_reset", self._on_reset)

    # --- lifecycle ----------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Read the baselines and the stored memory, and open the topics.

        Raises:
            BadInput: a baseline cannot be read, or the folder cannot be made or is another monitor's.
        """
        release_freed_memory()
        namespace = self.get_namespace().strip("/")
        below = "monitor" if namespace == NAMESPACE else f"monitor_{namespace.replace('/', '_')}"
        self.folder = Path(self.settings.folder or Path("runs") / below)
        self.baselines, period = _baselines(self.settings.baseline), self.spec.settings.control_period
        self.memory = Memory(self.folder, Origin.of(self.spec.controller_rig, period), tuple(self.baselines))
        self.lock = FolderLock(self.folder, "monitor")
        if self.lock.remark:
            self.get_logger().warning(self.lock.remark)
        self.recorder = FlightRecorder(self.folder / "flights", self.settings.flights, self.settings.flight_size)
        self.debounced = DebouncedSummary()
        self.summary = Summary(0, "no samples yet")
        self.failure = ""
        self.last_saved = -math.inf
        self.tripped = deque[tuple[float, str]]()
        self.flights = deque[Flight]()
        self._begin_monitor()
        self.topics, self.informed = MonitoredTopics(self), InformedControllers(self)
        self.health_publisher = self.create_publisher(ModelHealth, MODEL_HEALTH.name, control_qos(MODEL_HEALTH.depth))

    def release(self) -> None:
        """Close memory and topics, and end a diagnosis under way."""
        # The folder first: if `prepare` failed, some topics do not exist.
        self.memory.close()
        self.lock.release()
        self.topics.destroy()
        self.informed.destroy()
        self.destroy_publisher(self.health_publisher)
        self.monitor.close()

    def _begin_monitor(self) -> None:
        """Create a monitor that continues from the folder's memory; unusable files are set aside."""
        self.monitor = self._new_monitor()
        saved = self._restore()
        try:
            self.memory.check_writable()
            if remark := self.memory.open_history():
                self.get_logger().warning(remark)
        except (BadInput, NotWritten) as error:
            self._report_failure(f"the memory cannot be written: {error}")
        max_wait = LOCKSTEP_MAX_WAIT if self.lockstep else MAX_WAIT
        anchors, end = (saved.anchors, saved.end) if saved else ((), 0.0)
        self.assembler = CycleAssembler(self.spec.settings.control_period, anchors, end, max_wait)

    def _new_monitor(self) -> Monitor:
        return Monitor(self.spec.controller_rig, self.monitoring_parameters, ProcessExaminer(), self.baselines)

    def _restore(self) -> SavedMonitor | None:
        """Continue from the folder's memory; set it aside if it cannot be used."""
        try:
            saved = self.memory.restore()
            if saved is not None:
                self.monitor.restore(saved.state)
        except UNUSABLE as error:
            problem = f"the monitor's memory is inconsistent ({error})"
            reason = error if isinstance(error, BadInput) else BadInput(problem, str(self.folder), LEARNS_ANEW)
            self.get_logger().warning(f"the monitor learns again: {self.memory.put_aside(reason)}")
            self.monitor.close()
            self.monitor = self._new_monitor()
            return None
        return saved

    def start(self) -> None:
        """Start reading the graph."""
        # The loops with deadlines run without garbage collection; this one has time, and cyclic references accumulate.
        gc.enable()
        trim_memory()
        self.last_snapshots = self.memory_released = time.monotonic()
        self.day = today()
        self.last_published = -math.inf

    def stop(self) -> None:
        """Save the memory."""
        self._save(happened=True)

    # --- the loop -------------------------------------------------------------------------------------

    def once(self) -> None:
        """Read the gathered messages and judge the complete blocks."""
        time.sleep(READ_INTERVAL)
        events = self._carry_out_requests()
        try:
            events += self._read_messages()
            events += [Event(self.assembler.end, *event) for event in self.informed.measure()]
        except RuntimeError as error:
            # The diagnosis process died; the memory dates from before it began.
            self.failure = str(error)
            self.get_logger().error(self.failure)
            self.monitor.close()
            self._begin_monitor()
        for event in events:
            self.get_logger().info(f"{event.kind}: {event.text}")
        self._record_flights()
        self._save(happened=bool(events))
        self._publish(happened=bool(events))
        self._start_daily_report()
        # Learning or diagnosis took more memory than is needed from now on.
        if events or time.monotonic() - self.memory_released > MEMORY_RELEASE_INTERVAL:
            self.memory_released = time.monotonic()
            trim_memory()

    def _read_messages(self) -> list[Event]:
        """Read all messages, and return the events."""
        stretches, snapshots = self.topics.read(self.assembler)
        self.tripped.extend((time.monotonic() + TRIP_DELAY, cause) for cause in self.topics.trips())
        events = self.monitor.add(np.zeros(0), {})
        for stretch in stretches:
            if stretch.interrupted:
                self.monitor.interrupt()
            events += self.monitor.add(stretch.time_s, stretch.signals)
        if snapshots:
            # After the work on the snapshots, which may take long: messages that arrive meanwhile wait.
            self.last_snapshots = time.monotonic()
        return events

    def _carry_out_requests(self) -> list[Event]:
        """Carry out the service requests."""
        events = list[Event]()
        while self.requests:
            request = self.requests.popleft()
            self.debounced.release()
            if request == "acknowledge":
                events.append(Event(self.assembler.end, "acknowledged", f"{self.monitor.acknowledge()} changes"))
            elif request == "accept":
                events.append(Event(self.assembler.end, "accepted", self._accept()))
            else:
                self.monitor.reset()
                events.append(Event(self.assembler.end, "reset", "after a repair: the healthy rig is learnt again"))
        return events

    def _accept(self) -> str:
        """Adopt the changes into the rig, write its file, and begin to measure the benefit of passing it to the controllers."""
        rig = self.monitor.accept()
        if rig is None:
            return "there is no change with a cause to accept"
        accepted = rig_text(rig_to_mapping(rig))
        path = self.folder / ACCEPTED
        result = f"the rig with its changes is in {path}"
        try:
            write_accepted(path, accepted)
        except NotWritten as error:
            result = f"the rig with its changes cannot be written: {error}"
            self._report_failure(result)
        self.informed.end()
        try:
            accepted_model(accepted, self.spec.controller_rig, self.spec.settings.control_period, "accepted rig")
        except BadInput as error:
            return f"{result}; no controller is informed: {error}"
        self.informed.begin(accepted)
        return f"{result}; controllers with accept_rig are informed in {BENEFIT_TIME:g} s"

    def _record_flights(self) -> None:
        """Start writing and diagnosing the record before a trip, one flight at a time, and only while no diagnosis runs."""
        while self.tripped and time.monotonic() > self.tripped[0][0]:
            _, cause = self.tripped.popleft()
            recording = self.monitor.recording(self.settings.flight_time)
            if len(recording) and self.settings.flights and len(self.flights) < MAX_PENDING_FLIGHTS:
                stamp_ns = self.assembler.stamp_ns(self.assembler.end)
                self.flights.append(Flight(recording, cause, stamp_ns))
        busy = self.recorder.busy or (self.published_health is not None and self.published_health.state == State.EXAMINING)
        if not self.flights or busy:
            return
        learnt = self.monitor.saved_state().learnt
        baselines, own = [Path(name) for name in self.baselines], learnt.recording if learnt else None
        rig, period = self.spec.controller_rig, self.spec.settings.control_period
        try:
            folder = self.recorder.begin(self.flights.popleft(), rig, period, baselines, own)
        except (OSError, NotWritten) as error:
            self._report_failure(f"the flight recorder cannot write: {error}")
            return
        self.get_logger().warning(f"the gate has tripped: the samples before it are in {folder}")

    def _start_daily_report(self) -> None:
        """Start the report of the day that has ended, in another process: plotting takes memory."""
        if (now := today()) == self.day:
            return
        over, self.day = self.day, now
        self._save(happened=True)
        command = [sys.executable, "-m", "ehls_ros", "report", str(self.folder), "--day", over.isoformat()]
        self.reporting = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        self.get_logger().info(f"writing the report of {over} to {self.folder}")

    def _save(self, *, happened: bool) -> None:
        """Save the memory, at once after an event."""
        monitor = self.monitor
        newest = monitor.history[-1].time if monitor.history else -math.inf
        if not happened and newest == self.last_saved and not self.memory.due():
            return
        self.last_saved = newest
        try:
            self.memory.save(monitor.saved_state(), self.assembler.anchors, self.assembler.end, happened=happened)
        except NotWritten as error:
            self._report_failure(f"the memory cannot be written: {error}")
        del monitor.history[:-MAX_HISTORY]

    def _report_failure(self, complaint: str) -> None:
        """Report a failure in log and diagnostics; monitoring continues."""
        self.failure = complaint
        self.get_logger().error(complaint)

    # --- publishing -------------------------------------------------------------------------------------

    def _publish(self, *, happened: bool) -> None:
        """Publish the rig's health on change, and at intervals."""
        now = time.monotonic()
        if not happened and now - self.last_published < PUBLISH_INTERVAL:
            return
        self.last_published = now
        health = self.monitor.health()
        if now - self.last_snapshots > MAX_SILENCE:
            health = health._replace(state=State.IDLE, reason="no snapshots arrive")
        elif not self.assembler.driving:
            health = health._replace(state=State.IDLE, reason="the gate is closed, so no command reaches the valve")
        self.published_health = health
        self.summary = self.debounced.update(health.summary(self.monitor.reference, self.assembler.stamp_ns))
        self.health_publisher.publish(self._message(health))
        self.report_change()

    def _message(self, health: Health) -> ModelHealth:
        stamp_ns = self.assembler.stamp_ns
        now_ns = stamp_ns(self.assembler.end)
        return ModelHealth(
            header=Header(stamp=time_of(now_ns), frame_id=loader_frame(self.get_namespace())),
            state=int(health.state),
            reason=health.reason,
            summary=self.summary.sentence,
            baseline=health.baseline,
            watched=health.watched / HOUR,
            outside=health.outside,
            false_alarms=self.monitoring_parameters.mean_time_between_false_alarms,
            changes=[self._change(change, now_ns) for change in health.changes[-MAX_CHANGES:]],
            coefficients=[_coefficient(reading, health.rates.get(reading.name, UNKNOWN)) for reading in health.readings],
        )

    def _change(self, change: FoundChange, now_ns: int) -> ModelChange:
        stamp_ns = self.assembler.stamp_ns
        parameters = change.causes[0].parameters if change.causes else {}
        return ModelChange(
            number=change.number,
            cause=change.causes[0].name if change.causes else "",
            equivalent_to=list(change.causes[0].equivalent_to) if change.causes else [],
            group=change.group,
            stage=change.stage,
            probability=change.causes[0].probability if change.causes else 0.0,
            parameters=list(parameters),
            values=[value.value for value in parameters.values()],
            deviations=[value.std for value in parameters.values()],
            units=[value.unit for value in parameters.values()],
            since=time_of(stamp_ns(change.since)),
            earliest=time_of(stamp_ns(change.earliest)),
            latest=time_of(stamp_ns(change.latest)),
            cleared=time_of(stamp_ns(change.cleared)),
            active=change.active,
            acknowledged=change.acknowledged,
            sentence=change.describe(self.monitor.reference, stamp_ns, now_ns),
        )

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report an unacknowledged change as a warning, otherwise the state of the monitor."""
        assembler, health = self.assembler, self.published_health
        figures: dict[str, Any] = {"lost": assembler.lost, "unanswered": assembler.unanswered, "folder": self.folder}
        if health is not None:
            figures |= {
                "state": health.state.name.lower(),
                "watched_h": health.watched / HOUR,
                "active_changes": len(health.active),
                "outside": health.outside,
                "baseline": health.baseline,
            }
        if not self.is_active:
            return OK, "inactive", figures
        level = WARN if self.failure or self.summary.level else OK
        return level, "; ".join(filter(None, (self.failure, self.summary.sentence))), figures

    def _on_acknowledge(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        changes = self.published_health.changes if self.published_health else ()
        new = [change for change in changes if not change.acknowledged]
        self.requests.append("acknowledge")
        response.success, response.message = True, "; ".join(change.name for change in new) or "nothing new"
        return response

    def _on_accept(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        active = self.published_health.active if self.published_health else ()
        changes = [change for change in active if change.causes and not change.before]
        response.success = bool(changes)
        response.message = "; ".join(change.name for change in changes) or "there is no change with a cause to accept"
        if changes:
            self.requests.append("accept")
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.requests.append("reset")
        response.success, response.message = True, "the healthy rig is learnt again"
        return response


def _coefficient(reading: Reading, rate: Estimate) -> TrackedCoefficient:
    return TrackedCoefficient(
        name=reading.name,
        unit=reading.unit,
        value=reading.value,
        deviation=reading.deviation,
        told=reading.identified,
        why_not=reading.why_not,
        rate=rate.value,
        rate_deviation=rate.std,
    )


def _baselines(names: str) -> dict[str, Trajectory]:
    """Return the recordings named by a parameter, by their full paths.

    Raises:
        BadInput: one cannot be read.
    """
    paths = [Path(name.strip()).resolve() for name in names.split(",") if name.strip()]
    if not paths:
        return {}
    # Reading files needs libraries that a monitor without baselines does not load.
    from ehls_ros.experiments.run_folder import recording_in
    from ehls_ros.recording.load import load

    return {str(path): load(recording_in(path), None, USED) for path in paths}


def main() -> NoReturn:
    """Run the node, with lower priority than the nodes with deadlines."""
    give_way()
    run_node(MonitorNode)


if __name__ == "__main__":
    main()
