"""`monitor_node`: watches the rig while it runs and reports changes of its model since the healthy baseline."""

import gc
import math
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool, Header, String
from std_srvs.srv import Trigger

from ehls_msgs.msg import (
    ControllerStatus,
    Disturbance,
    Driver,
    LoaderState,
    ModelChange,
    ModelHealth,
    TrackedCoefficient,
    ValveCommand,
)
from ehls_ros.control.controllers.base import FORCE_ERROR
from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.diagnosis.record import USED
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.accepted_rig import accepted_model, write_accepted
from ehls_ros.experiments.monitoring.benefit import Benefit
from ehls_ros.experiments.monitoring.examination import InItsOwnProcess
from ehls_ros.experiments.monitoring.flight_recorder import Flight, FlightRecorder
from ehls_ros.experiments.monitoring.following import LONG_PATIENCE, PATIENCE, Follower, Snapshot
from ehls_ros.experiments.monitoring.health import Event, FoundChange, Health, State
from ehls_ros.experiments.monitoring.memory import UNUSABLE, Kept, Memory
from ehls_ros.experiments.monitoring.monitor import Monitor
from ehls_ros.experiments.monitoring.parameters import Parameters as Watching
from ehls_ros.experiments.monitoring.rates import MOST_HISTORY
from ehls_ros.experiments.monitoring.wording import HeldLevel, Word, group, sentence, today, word
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.experiments.state_files.folder_lock import FolderLock
from ehls_ros.experiments.state_files.kinds import LEARNS_ANEW
from ehls_ros.experiments.state_files.state_file import Origin
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.hardware.realtime import be_modest, tidy
from ehls_ros.nodes.codec import Decoder
from ehls_ros.nodes.control import NAMESPACE, ControlNode
from ehls_ros.nodes.diagnostics import OK, WARN
from ehls_ros.nodes.frames import loader_frame
from ehls_ros.nodes.parameters import declare, values_of
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.telemetry import time_of
from ehls_ros.nodes.transport import RECORDER_DEPTH, Inbox, control_qos
from ehls_ros.physics.rig import rig_to_mapping
from ehls_ros.process import give_way
from ehls_ros.recording.topics import (
    ACCEPTED_RIG,
    CONTROLLER_STATUS,
    DIAGNOSTICS,
    DISTURBANCE,
    DRIVER,
    DRIVING,
    LOADER_STATE,
    MODEL_HEALTH,
    OF_GATE,
    TRIPPED_BY,
    VALVE_COMMAND,
    Topic,
)
from ehls_ros.schema import quantity, text
from ehls_ros.trajectory import Trajectory

REST = 0.1
"""Interval between bulk reads of the messages [s]; the middleware holds them meanwhile."""

HELD_UP = 20.0
"""Longest interval between bulk reads while the monitor computes something else [s]."""

MOST_GATHERED = 100_000
"""Maximum number of messages of a topic that gather: 20 s at 5 kHz."""

TELL = 2.5
"""Shortest time between two messages if no event occurs [s]."""

TIDY = 60.0
"""Time between two releases of free memory [s]; no cycle waits for this loop."""

QUIET = 2.0
"""Time without snapshots after which judging stops [s]."""

AFTER_TRIP = 0.5
"""Time after the report of a trip by which the samples before it have arrived [s]."""

GATE = f"{OF_GATE}\0".encode()
"""Key of the safety gate's diagnostics as encoded in a message."""

ACCEPTED = "rig_accepted.yaml"
"""File of the rig with the changes that an operator has accepted, in the monitor's folder."""

BENEFIT = 30.0
"""Time over which the force error is measured before and after controllers receive an accepted rig [s]."""

SETTLING = 2.0
"""Time between the two measurements [s]."""

MOST_FLIGHTS = 2
"""Maximum number of trips waiting to be written; repeated trips add no information."""

MOST_CHANGES = 50
"""Maximum number of changes published, the newest ones; the memory has all."""

HOUR = 3600.0

UNKNOWN = Estimate(math.nan, math.nan, "")


class Parameters(NamedTuple):
    """Baseline recordings, memory folder and flight recorder of the monitor."""

    baseline: Annotated[
        str, text("recordings from when the rig was well, separated by commas; empty: the rig file and the first minutes")
    ] = ""
    folder: Annotated[
        str, text("folder of memory and flight recorder; empty: runs/monitor, with the namespace of another rig")
    ] = ""
    flights: Annotated[int, quantity("1", "gate trips kept by the flight recorder; 0: none", minimum=0, maximum=1000)] = 10
    flight_size: Annotated[float, quantity("MB", "size of all of them together", minimum=1.0)] = 500.0
    flight_time: Annotated[float, quantity("s", "time before a trip that is kept", minimum=1.0, maximum=600.0)] = 60.0


class MonitorNode(ControlNode):
    """Follows the graph like the recorder; no cycle waits for it, and it blocks no sender."""

    answers = False
    background = True
    announces = False

    def __init__(self) -> None:
        """Declare the parameters and the services."""
        super().__init__("monitor_node")
        declare(self, Watching, live=False)
        declare(self, Parameters, live=False)
        self.watching = values_of(self, Watching, self.get_name())
        self.own = values_of(self, Parameters, self.get_name())
        self.frame = loader_frame(self.get_namespace())
        self.asked = deque[str]()
        self.told: Health | None = None
        self.create_service(Trigger, "monitor_acknowledge", self._on_acknowledge)
        self.create_service(Trigger, "monitor_accept", self._on_accept)
        self.create_service(Trigger, "monitor_reset", self._on_reset)

    # --- lifecycle ----------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Read the baselines and the stored memory, and open the topics.

        Raises:
            BadInput: a baseline cannot be read, or the folder cannot be made or is another monitor's.
        """
        be_modest()
        namespace = self.get_namespace().strip("/")
        below = "monitor" if namespace == NAMESPACE else f"monitor_{namespace.replace('/', '_')}"
        self.folder = Path(self.own.folder or Path("runs") / below)
        self.baselines, period = _baselines(self.own.baseline), self.spec.settings.control_period
        self.memory = Memory(self.folder, Origin.of(self.spec.controller_rig, period), tuple(self.baselines))
        self.lock = FolderLock(self.folder, "monitor")
        if self.lock.remark:
            self.get_logger().warning(self.lock.remark)
        self.recorder = FlightRecorder(self.folder / "flights", self.own.flights, self.own.flight_size)
        self.held = HeldLevel()
        self.word = Word(0, "no samples yet")
        self.failure = ""
        self.kept = -math.inf
        self.trip = ""
        self.tripped = deque[tuple[float, str]]()
        self.flights = deque[Flight]()
        self._begin_monitor()
        self.states = self._cycle_inbox(LoaderState, LOADER_STATE)
        self.commands = self._cycle_inbox(ValveCommand, VALVE_COMMAND)
        self.disturbances = self._cycle_inbox(Disturbance, DISTURBANCE)
        self.drivers = Inbox(self, Driver, DRIVER.name, control_qos(DRIVER.depth), owned=LOADER_STATE.name)
        self.driving = Inbox(self, Bool, DRIVING.name, control_qos(DRIVING.depth))
        self.diagnostics = Inbox(self, DiagnosticArray, DIAGNOSTICS.name, QoSProfile(depth=200))
        self.state, self.command, self.disturbance, self.status = (
            Decoder(LoaderState),
            Decoder(ValveCommand),
            Decoder(Disturbance),
            Decoder(ControllerStatus),
        )
        self.telling = self.create_publisher(ModelHealth, MODEL_HEALTH.name, control_qos(MODEL_HEALTH.depth))
        self.accepted = self.create_publisher(String, ACCEPTED_RIG.name, control_qos(ACCEPTED_RIG.depth))
        self.benefit: Benefit | None = None
        self.rig_told = ""
        self.errors: Inbox | None = None

    def _cycle_inbox(self, message: Any, topic: Topic) -> Inbox:
        """Return an inbox that blocks no sender: in realtime no sender waits for acknowledgement, and lost messages are gaps.

        In lockstep it loses only messages that a publisher no longer keeps by the time a busy machine lets it read.
        """
        if self.lockstep:
            return Inbox(self, message, topic.name, control_qos(RECORDER_DEPTH))
        depth = min(round(HELD_UP / self.spec.settings.control_period), MOST_GATHERED)
        return Inbox(self, message, topic.name, QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT))

    def release(self) -> None:
        """Close memory and topics, and end a diagnosis under way."""
        # The folder first: topics that `prepare` did not get to open do not exist.
        self.memory.close()
        self.lock.release()
        for inbox in (self.states, self.commands, self.disturbances, self.drivers, self.driving, self.diagnostics):
            inbox.destroy()
        self._end_benefit()
        self.destroy_publisher(self.telling)
        self.destroy_publisher(self.accepted)
        self.monitor.close()

    def _begin_monitor(self) -> None:
        """Create a monitor that continues from the folder's memory; unusable files are set aside."""
        self.monitor = self._new_monitor()
        kept = self._recall()
        try:
            self.memory.check_writable()
            if said := self.memory.open_history():
                self.get_logger().warning(said)
        except (BadInput, NotWritten) as error:
            self._fail(f"what is known cannot be kept: {error}")
        patience = LONG_PATIENCE if self.lockstep else PATIENCE
        anchors, end = (kept.anchors, kept.end) if kept else ((), 0.0)
        self.follower = Follower(self.spec.settings.control_period, anchors, end, patience)

    def _new_monitor(self) -> Monitor:
        return Monitor(self.spec.controller_rig, self.watching, InItsOwnProcess(), self.baselines)

    def _recall(self) -> Kept | None:
        """Continue from the folder's memory; set it aside if it cannot be used."""
        try:
            kept = self.memory.restore()
            if kept is not None:
                self.monitor.restore(kept.remembered)
        except UNUSABLE as error:
            what = f"the monitor's memory makes no sense ({error})"
            reason = error if isinstance(error, BadInput) else BadInput(what, str(self.folder), LEARNS_ANEW)
            self.get_logger().warning(f"the monitor learns anew: {self.memory.put_aside(reason)}")
            self.monitor.close()
            self.monitor = self._new_monitor()
            return None
        return kept

    def start(self) -> None:
        """Start following the graph."""
        # The loops with deadlines run without garbage collection; this one has time, and lists of findings refer to each other.
        gc.enable()
        tidy()
        self.heard = self.tidied = time.monotonic()
        self.day = today()
        self.published = -math.inf

    def stop(self) -> None:
        """Save the memory."""
        self._keep(happened=True)

    # --- the loop -------------------------------------------------------------------------------------

    def once(self) -> None:
        """Read the gathered messages and judge the complete blocks."""
        time.sleep(REST)
        events = self._asked()
        try:
            events += self._follow()
            events += self._measure_benefit()
        except RuntimeError as error:
            # The diagnosis process died; the memory dates from before it began.
            self.failure = str(error)
            self.get_logger().error(self.failure)
            self.monitor.close()
            self._begin_monitor()
        for event in events:
            self.get_logger().info(f"{event.kind}: {event.text}")
        self._record_flights()
        self._keep(happened=bool(events))
        self._tell(happened=bool(events))
        self._report_day()
        # Learning or diagnosis took more memory than is needed from now on.
        if events or time.monotonic() - self.tidied > TIDY:
            self.tidied = time.monotonic()
            tidy()

    def _follow(self) -> list[Event]:
        """Read all messages, and return the events."""
        follower, plant = self.follower, self.owners.of(LOADER_STATE.name)
        while (driver := self.drivers.take()) is not None:
            follower.hear_driver(driver[1], driver[3])
        snapshots = [
            Snapshot(message[0], message[1], message[2:-1], info["source_timestamp"])
            for raw, info in _taken(self.states)
            if (message := self.state(raw)) is not None and plant.admits(message[-1])
        ]
        # After the snapshots: messages older than the newest snapshot have arrived by now.
        for raw, info in _taken(self.driving):
            follower.hear_driving(deserialize_message(raw, Bool).data, info["source_timestamp"])
        follower.hear_commands(
            (message[1], message[2], message[3], info["source_timestamp"])
            for raw, info in _taken(self.commands)
            if (message := self.command(raw)) is not None
        )
        follower.hear_disturbances(
            (message[1], message[2:-1])
            for raw, _ in _taken(self.disturbances)
            if (message := self.disturbance(raw)) is not None
        )
        self._hear_trips()
        events = self.monitor.add(np.zeros(0), {})
        for stretch in follower.follow(snapshots):
            if stretch.interrupted:
                self.monitor.interrupt()
            events += self.monitor.add(stretch.time_s, stretch.signals)
        if snapshots:
            # After the work on the snapshots, which may take long: messages that arrive meanwhile wait.
            self.heard = time.monotonic()
        return events

    def _hear_trips(self) -> None:
        """Register each trip of the gate once."""
        for raw, _ in _taken(self.diagnostics):
            if GATE not in raw:
                continue
            for status in deserialize_message(raw, DiagnosticArray).status:
                figures = {value.key: value.value for value in status.values}
                if status.hardware_id != self.get_namespace().strip("/") or OF_GATE not in figures:
                    continue
                cause = figures.get(TRIPPED_BY, "")
                if cause and cause != self.trip:
                    self.tripped.append((time.monotonic() + AFTER_TRIP, cause))
                self.trip = cause

    def _asked(self) -> list[Event]:
        """Carry out the service requests."""
        events = list[Event]()
        while self.asked:
            request = self.asked.popleft()
            self.held.release()
            if request == "acknowledge":
                events.append(Event(self.follower.end, "acknowledged", f"{self.monitor.acknowledge()} changes"))
            elif request == "accept":
                events.append(Event(self.follower.end, "accepted", self._accept()))
            else:
                self.monitor.reset()
                events.append(Event(self.follower.end, "reset", "the rig was repaired: what is healthy is learnt anew"))
        return events

    def _accept(self) -> str:
        """Adopt the changes into the rig, write its file, and begin to measure the benefit of passing it to the controllers."""
        rig = self.monitor.accept()
        if rig is None:
            return "there is no change with a cause to accept"
        self.rig_told = rig_text(rig_to_mapping(rig))
        path = self.folder / ACCEPTED
        kept = f"the rig with its changes is {path}"
        try:
            write_accepted(path, self.rig_told)
        except NotWritten as error:
            kept = f"the rig with its changes is in no file: {error}"
            self._fail(kept)
        self._end_benefit()
        period = self.spec.settings.control_period
        try:
            accepted_model(self.rig_told, self.spec.controller_rig, period, "accepted rig")
        except BadInput as error:
            return f"{kept}; no controller is told: {error}"
        self.benefit = Benefit(round(BENEFIT / period))
        self.errors = self._cycle_inbox(ControllerStatus, CONTROLLER_STATUS)
        return f"{kept}; controllers with accept_rig are told in {BENEFIT:g} s"

    def _measure_benefit(self) -> list[Event]:
        """Measure the force error before and after controllers receive an accepted rig."""
        if self.benefit is None or self.errors is None:
            return []
        decoded = (self.status(raw) for raw, _ in _taken(self.errors))
        self.benefit.add(np.array([message[2 + FORCE_ERROR] for message in decoded if message is not None]))
        if self.benefit.ready:
            self.accepted.publish(String(data=self.rig_told))
            self.benefit.tell(round(SETTLING / self.spec.settings.control_period))
            return [Event(self.follower.end, "told", "the controllers are told of the accepted rig")]
        if not self.benefit.complete:
            return []
        said = self.benefit.sentence()
        self._end_benefit()
        return [Event(self.follower.end, "benefit", said)]

    def _end_benefit(self) -> None:
        if self.errors is not None:
            self.errors.destroy()
        self.benefit, self.errors = None, None

    def _record_flights(self) -> None:
        """Start writing and diagnosing the record before a trip, one flight at a time, and only while no diagnosis runs."""
        while self.tripped and time.monotonic() > self.tripped[0][0]:
            _, cause = self.tripped.popleft()
            recording = self.monitor.recording(self.own.flight_time)
            if len(recording) and self.own.flights and len(self.flights) < MOST_FLIGHTS:
                stamp_ns = self.follower.stamp_ns(self.follower.end)
                self.flights.append(Flight(recording, cause, stamp_ns))
        busy = self.recorder.busy or (self.told is not None and self.told.state == State.EXAMINING)
        if not self.flights or busy:
            return
        learnt = self.monitor.remembered().learnt
        baselines, own = [Path(name) for name in self.baselines], learnt.recording if learnt else None
        rig, period = self.spec.controller_rig, self.spec.settings.control_period
        try:
            folder = self.recorder.begin(self.flights.popleft(), rig, period, baselines, own)
        except (OSError, NotWritten) as error:
            self._fail(f"a flight cannot be written: {error}")
            return
        self.get_logger().warning(f"the gate has tripped: the time before it is in {folder}")

    def _report_day(self) -> None:
        """Start the report of the day that has ended, in another process: plotting takes memory."""
        if (now := today()) == self.day:
            return
        over, self.day = self.day, now
        self._keep(happened=True)
        command = [sys.executable, "-m", "ehls_ros", "report", str(self.folder), "--day", over.isoformat()]
        self.reporting = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        self.get_logger().info(f"the report of {over} is written to {self.folder}")

    def _keep(self, *, happened: bool) -> None:
        """Save the memory, at once after an event."""
        monitor = self.monitor
        newest = monitor.history[-1].time if monitor.history else -math.inf
        if not happened and newest == self.kept and not self.memory.due():
            return
        self.kept = newest
        try:
            self.memory.keep(monitor.remembered(), self.follower.anchors, self.follower.end, happened=happened)
        except NotWritten as error:
            self._fail(f"what is known cannot be kept: {error}")
        del monitor.history[:-MOST_HISTORY]

    def _fail(self, complaint: str) -> None:
        """Report a failure in log and diagnostics; the watch continues."""
        self.failure = complaint
        self.get_logger().error(complaint)

    # --- publishing -------------------------------------------------------------------------------------

    def _tell(self, *, happened: bool) -> None:
        """Publish the rig's health on change, and at intervals."""
        now = time.monotonic()
        if not happened and now - self.published < TELL:
            return
        self.published = now
        health = self.monitor.health()
        if now - self.heard > QUIET:
            health = health._replace(state=State.IDLE, reason="no cycles arrive")
        elif not self.follower.driving:
            health = health._replace(state=State.IDLE, reason="the gate is closed, so no command reaches the valve")
        self.told = health
        self.word = self.held.take(word(health, self.spec.controller_rig, self.follower.stamp_ns))
        self.telling.publish(self._message(health))
        self.report_change()

    def _message(self, health: Health) -> ModelHealth:
        stamp_ns = self.follower.stamp_ns
        now_ns = stamp_ns(self.follower.end)
        return ModelHealth(
            header=Header(stamp=time_of(now_ns), frame_id=self.frame),
            state=int(health.state),
            reason=health.reason,
            summary=self.word.sentence,
            baseline=health.baseline,
            watched=health.watched / HOUR,
            outside=health.outside,
            false_alarms=self.watching.mean_time_between_false_alarms,
            changes=[self._change(change, now_ns) for change in health.changes[-MOST_CHANGES:]],
            coefficients=[_coefficient(reading, health.rates.get(reading.name, UNKNOWN)) for reading in health.readings],
        )

    def _change(self, change: FoundChange, now_ns: int) -> ModelChange:
        stamp_ns = self.follower.stamp_ns
        parameters = change.causes[0].parameters if change.causes else {}
        return ModelChange(
            number=change.number,
            cause=change.causes[0].name if change.causes else "",
            equivalent_to=list(change.causes[0].equivalent_to) if change.causes else [],
            group=group(change),
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
            sentence=sentence(change, self.spec.controller_rig, stamp_ns, now_ns),
        )

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report an unacknowledged change as a warning, otherwise the state of the watch."""
        follower, told = self.follower, self.told
        figures: dict[str, Any] = {"lost": follower.lost, "unanswered": follower.unanswered, "folder": self.folder}
        if told is not None:
            figures |= {
                "state": told.state.name.lower(),
                "watched_h": told.watched / HOUR,
                "active_changes": len(told.active),
                "outside": told.outside,
                "baseline": told.baseline,
            }
        if not self.is_active:
            return OK, "inactive", figures
        level = WARN if self.failure or self.word.level else OK
        return level, "; ".join(filter(None, (self.failure, self.word.sentence))), figures

    def _on_acknowledge(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        new = [change for change in self.told.changes if not change.acknowledged] if self.told else []
        self.asked.append("acknowledge")
        response.success, response.message = True, "; ".join(change.name for change in new) or "nothing new"
        return response

    def _on_accept(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        changes = [change for change in self.told.active if change.causes and not change.before] if self.told else []
        response.success = bool(changes)
        response.message = "; ".join(change.name for change in changes) or "there is no change with a cause to accept"
        if changes:
            self.asked.append("accept")
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.asked.append("reset")
        response.success, response.message = True, "what is healthy is learnt anew"
        return response


def _taken(inbox: Inbox) -> Iterator[tuple[bytes, Mapping[str, int]]]:
    """Yield the waiting messages of an inbox."""
    while (taken := inbox.take_raw()) is not None:
        yield taken


def _coefficient(reading: Reading, rate: Estimate) -> TrackedCoefficient:
    return TrackedCoefficient(
        name=reading.name,
        unit=reading.unit,
        value=reading.value,
        deviation=reading.deviation,
        told=reading.told,
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
