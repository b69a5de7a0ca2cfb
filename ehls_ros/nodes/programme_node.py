"""`programme_node`: runs a test programme in place of the reference node; counts load cycles, stops on limits, resumes."""

import hashlib
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from ehls_msgs.msg import LoaderState, ProgrammePoint
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.programme.counting import Counter, LoadCycle, Sample
from ehls_ros.control.programme.expansion import programme_of
from ehls_ros.control.programme.motion import Motion, Rows, Runner, State
from ehls_ros.control.programme.pacing import Pacer
from ehls_ros.errors import BadInput
from ehls_ros.experiments.programme_records import MAX_HOLDS, Records, digest, open_records, plain, state_file
from ehls_ros.experiments.spec import with_programme
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.experiments.state_files.kinds import ProgrammeState
from ehls_ros.experiments.state_files.state_file import Origin, StateFile
from ehls_ros.nodes.ahead import LEAD, PAUSE, AheadNode
from ehls_ros.nodes.codec import NANOSECONDS, decode_flag
from ehls_ros.nodes.diagnostics import OK, WARN
from ehls_ros.nodes.graph_nodes import PROGRAMME
from ehls_ros.nodes.loop import WAIT
from ehls_ros.nodes.parameters import declare
from ehls_ros.nodes.reference_node import MEASURED
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.transport import Inbox, Outbox, control_qos, message_class, newest_qos
from ehls_ros.physics import sensors
from ehls_ros.recording.topics import DEPTH, DRIVING, LOADER_STATE, PROGRAMME_POINT, REFERENCE_TOPICS
from ehls_ros.schema import quantity, text

MARGIN = 0.05
"""Lead time before a programme begins in realtime, so that its first rows arrive in time [s]."""

QUIET, FEW = 0.3, 5
"""A rig in lockstep counts as waiting for its reference if fewer than these snapshots arrive in this time [s]: behind a bridge,
it waits for a tenth of a second in each cycle."""


MIN_LEAD = 20
"""Fewest control cycles published ahead, and those published while the programme waits for the measured value."""

UNITS = {"force": "N", "position": "m"}
"""Unit of a programme's values, by the quantity that it prescribes."""

WAITS = "waits for the safety gate to open the valve"
"""Reason given for a programme that has not begun, since the rig's gate has been closed from the start."""

CLOSED = "the safety gate closed the valve"
"""Beginning of the reason given for a programme that was held by an emergency stop or a trip."""

AFTER_CLOSURE = "enable the rig, then programme_resume continues"

ON_REQUEST = "on request"
"""Reason given for a programme that its operator stopped."""


class Parameters(NamedTuple):
    """Programme, log folder and start of the run."""

    programme: Annotated[str, text("programme's file; empty: the spec's reference, which is one")] = ""
    folder: Annotated[str, text("folder of log and state; empty: runs/ and the programme's title")] = ""
    anew: Annotated[bool, text("begin programme and log anew; false: continue from the state in the folder")] = False
    ahead: Annotated[
        int,
        quantity(
            "1",
            "control cycles by which the reference is published ahead; a stop acts after them",
            minimum=MIN_LEAD,
            maximum=LEAD,
        ),
    ] = LEAD
    start_time: Annotated[
        float,
        quantity(
            "s", "time in which the reference is led in from where the rig is; 0: the programme begins at once", minimum=0.0
        ),
    ] = 0.0


@dataclass(slots=True)
class Tally:
    """Count of the measured load cycles.

    Attributes:
        counter: finds the load cycles.
        next: the next control cycle to count.
        samples: block, repetition, load cycles, phase, state and reference of published control cycles not counted yet.
        waiting: snapshots of control cycles not published yet.
        newest: the last load cycle found.
    """

    counter: Counter
    next: int = 0
    samples: dict[int, tuple[int, int, int, float, int, float]] = field(default_factory=dict)
    waiting: list[tuple[Any, ...]] = field(default_factory=list)
    newest: LoadCycle | None = None


@dataclass(slots=True)
class RigProcess:
    """The process of the rig that the programme runs on.

    Attributes:
        identifier: of the process.
        senders: publishers of snapshots that may be it.
        departed: publishers of earlier processes.
        is_certain: whether there is a single publisher; a killed process seems to be present for a while.
    """

    identifier: str = ""
    senders: set[bytes] = field(default_factory=set)
    departed: set[bytes] = field(default_factory=set)
    is_certain: bool = False

    def identify(self, publishers: Iterable[bytes]) -> None:
        """Determine the process from the publishers of snapshots that are present."""
        present = set(publishers)
        self.senders = present - self.departed or present
        self.is_certain = len(self.senders) == 1
        self.identifier = hashlib.blake2b(b"".join(sorted(self.senders)), digest_size=16).hexdigest()


class ProgrammeNode(AheadNode):
    """Publishes a programme's reference and points, a pure function of the control cycle between two requests.

    A node that is killed and restarted while the rig still has reference therefore continues without a bump. If the rig ran out
    of reference or is another process, the programme holds its position and waits to be resumed.
    """

    publishes_actuator = True

    def __init__(self) -> None:
        """Declare the parameters and the services.

        Raises:
            BadInput: there is no programme, or its folder holds another one.
        """
        super().__init__(PROGRAMME)
        declare(self, Parameters, live=False)
        self.spec = with_programme(self.spec, self.text_parameter("programme"))
        if self.spec.reference.name != "programme":
            what = f"the spec's reference is {self.spec.reference.name}"
            raise BadInput(what, self.get_name(), "a programme there, or a file in the parameter programme")
        self.programme = programme_of(self.spec.reference.parameters)
        self.digest = digest(self.programme)
        self.lead = int(self.get_parameter("ahead").value)
        self.start_time = float(self.get_parameter("start_time").value)
        self.follows = CONTROLLERS.load(self.spec.controller.name).FOLLOWS
        self.requests: list[str] = []
        # Made by `prepare`:
        self.records: Records
        self.file: StateFile
        self.holds: tuple[float | None, ...]
        self.tally: Tally
        self.pacer: Pacer
        self.rig: RigProcess
        self.runner: Runner | None
        self.unwritten: str
        self.state: State
        self.block: int
        self.states: Inbox
        self.present: Inbox
        self.other: Inbox | None
        self.points: Outbox
        self.driving: Inbox
        self.valve_follows: bool | None
        self.stamp_ns: int
        self.received: deque[float]
        for request in ("stop", "resume", "skip"):
            self.create_service(Trigger, f"programme_{request}", self._answer(request))

    def _answer(self, request: str) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        """Return the service's handler, which leaves the request to the loop."""

        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            refusal = self._refusal(request)
            response.success, response.message = (
                not refusal,
                refusal or f"{request} from control cycle {self.next} on, or later",
            )
            if response.success:
                self.requests.append(request)
            return response

        return answer

    def _refusal(self, request: str) -> str:
        if not self.is_active or self.runner is None:
            return "the programme has not begun"
        stopped = self.runner.motions[-1].rests is not None
        if request in self.requests:
            return f"{request} is under way"
        if self.state == State.FINISHED:
            return "the programme has finished"
        if request == "stop" and stopped and not self._waits:
            return "the programme is stopped"
        if request == "resume" and self.valve_follows is False:
            return f"the safety gate keeps the valve closed; {AFTER_CLOSURE}"
        return "the programme is not stopped" if request == "resume" and not stopped else ""

    def prepare(self) -> None:
        """Open records and topics.

        Raises:
            BadInput: log or state cannot be read or written, are another programme's, or are in use by another process.
        """
        chosen = self.text_parameter("folder")
        title = "".join(letter if letter.isalnum() else "_" for letter in self.programme.parameters.title)
        folder = Path(chosen) if chosen else Path("runs") / title
        origin = Origin.of(self.spec.rig, self.spec.settings.control_period)
        anew, limits = bool(self.get_parameter("anew").value), self.spec.rig.limits
        self.records = records = open_records(folder, self.programme, origin, self.follows, limits, anew=anew)
        for remark in records.remarks:
            self.get_logger().warning(remark)
        self.file, saved = state_file(folder, origin), records.state
        held = (*(saved.holds if saved else ()), self.programme.parameters.hold)
        self.holds = tuple(dict.fromkeys(held))[-MAX_HOLDS:]
        self.tally = Tally(Counter(self.programme, records.counted, saved.stiffness if saved else ()))
        self.pacer = Pacer(self.programme, self.spec.settings.control_period)
        self.rig, self.runner = RigProcess(), None
        self.unwritten = ""
        self.state, self.block = State.STARTING, 0
        super().prepare()
        self.states = Inbox(self, LoaderState, LOADER_STATE.name)
        self.present = Inbox(self, LoaderState, LOADER_STATE.name, newest_qos())
        topic = REFERENCE_TOPICS[self.follows]
        self.other = Inbox(self, message_class(topic.type), topic.name)
        self.points = Outbox(self, ProgrammePoint, PROGRAMME_POINT.name)
        self.driving = Inbox(self, Bool, DRIVING.name, control_qos(DRIVING.depth), decode_flag)
        # Unknown at first; that of a plant that does not publish it remains unknown.
        self.valve_follows = None
        self.stamp_ns = 0
        self.received = deque(maxlen=FEW)

    def open_outbox(self) -> Outbox:
        """Open the topic of the reference."""
        topic = REFERENCE_TOPICS[self.follows]
        return Outbox(self, message_class(topic.type), topic.name)

    def release(self) -> None:
        """Close records and topics."""
        # The records first: topics that `prepare` did not get to open do not exist.
        self.records.close()
        for part in (self.states, self.present, self.points, self.driving):
            part.destroy()
        self._ignore_other_references()
        super().release()

    def start(self) -> None:
        """Publish nothing yet: the first snapshot determines the control cycle in which the programme begins.

        A programme under way republishes in lockstep the rows that the rig may wait for: they may have been refused before.
        """
        if self.runner is not None and self.lockstep:
            self._send(max(self.last, 0), self.next - 1)

    def once(self) -> None:
        """Count the measured load cycles, and publish ahead of the newest control cycle."""
        self.waiter.wait(WAIT)
        while (progress := self.progress.take()) is not None:
            stamp, cycle = progress[:2]
            if cycle < self.last:
                if not self.lockstep and stamp <= self.stamp_ns:
                    continue
                if self.runner is not None:
                    self.rig.departed |= self.rig.senders
                    self._interrupt(cycle, "the rig was restarted")
            self._note_progress(cycle)
            self.stamp_ns = stamp
            self.epoch_ns = stamp - round(cycle * self.period_ns)
        closed = self._take_driving()
        if self.runner is None:
            self._begin()
            return
        if closed:
            self._hold_closed()
        elif self.valve_follows and self._waits:
            self.runner.resume(self.next)
        self._count()
        if self.last > self.next:
            self._interrupt(self.last, f"the rig had no reference from control cycle {self.next} on")
        self._follow_requests()
        self._publish_to(self.runner.horizon(self.last, self.lead, MIN_LEAD))
        time.sleep(PAUSE)
        if self._is_repeat_due():
            self._send(max(self.last, 0), self.next - 1)

    def stop(self) -> None:
        """Count the last control cycles, and save the state even if that fails."""
        if self.runner is not None:
            try:
                self._count()
            finally:
                self._save(self.next - 1, durable=True)

    def _take_driving(self) -> bool:
        """Read whether commands reach the valve; return whether they have ceased to since the last call."""
        closed = False
        while (driving := self.driving.take()) is not None:
            self.valve_follows = driving
            closed |= not driving
        return closed

    @property
    def _waits(self) -> bool:
        """Whether the programme has not begun because the valve has not been opened yet."""
        runner = self.runner
        return runner is not None and runner.motions[-1].rests is not None and runner.motions[-1].reason == WAITS

    def _hold_closed(self) -> None:
        """Hold the programme where the safety gate closed the valve: load cycles beyond that, though published, are not run."""
        runner, cycle = self._running(), self.tally.next
        before = runner.motions[-1]
        since, state = runner.at(max(cycle - 1, 0))
        if state == State.FINISHED or self._waits:
            return
        said = before.reason if before.rests is not None and before.reason else f"{CLOSED} in control cycle {cycle}"
        reference = float(runner.rows(self.next, 1).reference[0, 0])
        held = runner.resting(self.next, since, reference, said, before.skipped)
        runner.motions = [*(motion for motion in runner.motions if motion.first < self.next), held]
        self.tally.samples.clear()
        self.get_logger().warning(f"the programme is held: {said}; {AFTER_CLOSURE}")

    def _begin(self) -> None:
        """Determine the rig's present control cycle, and begin or continue there.

        Stored messages of earlier control cycles do not show it. In lockstep the newest stored snapshot does; in realtime a
        snapshot that is not stored.
        """
        # First the owner: a rig that follows another reference never pauses to reveal which snapshot is its newest.
        is_owned, now = self._owner_of_reference() is not None, self._present()
        if now is None or is_owned or (self.valve_follows is None and self.driving.publishers()):
            return
        self._ignore_other_references()
        measured, cycle = now[2 + MEASURED[self.follows]], now[1]
        if not math.isfinite(measured):
            # There is no position to lead the reference in from.
            measured = None
        self._identify_rig()
        saved = self.records.state
        if saved is None:
            first = cycle if self.lockstep else cycle + round(MARGIN / self.spec.settings.control_period)
            begun = Runner.beginning(self.programme, first, measured, self.start_time)
            self.runner = Runner(self.programme, self.spec.settings.control_period, (begun,))
            if self.valve_follows is False:
                start = self.programme.value(0.0) if measured is None else measured
                self.runner.motions = [self.runner.resting(first, 0.0, start, WAITS)]
            self.tally.next = cycle
        else:
            self.runner = Runner(self.programme, self.spec.settings.control_period, saved.motions)
            self.tally.next = saved.counting
            if saved.run != self.rig.identifier:
                self._interrupt(cycle, "the rig is another process", saved.seen, measured)
            else:
                # Snapshots from before the node ended are still available, as many as the rig keeps.
                since = max(saved.counting, cycle - DEPTH)
                self._remember(self.runner.rows(since, max(min(cycle, saved.published + 1) - since, 0)), since)
                # In lockstep the rig waits in the first control cycle without reference.
                if cycle > saved.published + 1:
                    self.next = saved.published + 1
                    self._count()
                    self._interrupt(cycle, "no reference was published while the node was stopped", saved.published, measured)
        self.next, self.last = cycle, max(cycle, self.last)
        if self.valve_follows is False:
            self._hold_closed()
        self._publish_to(self.runner.horizon(cycle, self.lead, MIN_LEAD))

    def _present(self) -> tuple[Any, ...] | None:
        """Return the rig's newest snapshot, once it is certain to be the newest."""
        if not self.lockstep:
            newest = None
            while (state := self.present.take()) is not None:
                newest = state
            return newest
        while (state := self.states.take()) is not None:
            self.tally.waiting.append(state)
            self.received.append(time.perf_counter())
        del self.tally.waiting[:-DEPTH]
        if self.last < 0 or not self.tally.waiting or self.tally.waiting[-1][1] < self.last:
            return None
        # A rig without reference waits, and its earlier messages have arrived once no more, or only few, arrive.
        newest = self.tally.waiting[-1]
        return newest if time.perf_counter() - self.received[0] > QUIET else None

    def _identify_rig(self) -> None:
        """Determine the rig's process."""
        self.rig.identify(bytes(info.endpoint_gid) for info in self.get_publishers_info_by_topic(LOADER_STATE.name))

    def _interrupt(self, cycle: int, reason: str, until: int | None = None, measured: float | None = None) -> None:
        """Hold the programme at the rig's last reference.

        Args:
            cycle: control cycle now.
            reason: cause of the interruption.
            until: last control cycle with reference; None: the one counted last.
            measured: measured value of the rig; None: the programme's value at that point.
        """
        runner = self._running()
        until = self.tally.next - 1 if until is None else until
        since, state = runner.at(max(until, 0))
        before = runner.motions[-1]
        if before.reason.startswith(CLOSED):
            # Control cycles before that motion may have been published without being run.
            since = before.since
        if measured is None or not math.isfinite(measured):
            measured = self.programme.value(since)
        if state == State.FINISHED:
            runner.motions = [Motion(cycle, "stop", (), self.programme.duration, self.programme.end, before.skipped)]
        else:
            said = before.reason if before.rests is not None and before.reason else reason
            runner.motions = [runner.resting(cycle, since, measured, said, before.skipped)]
            self.get_logger().warning(f"the programme is held: {said}; programme_resume continues it")
        self.tally.samples.clear()
        self.tally.next = self.next = cycle
        self._identify_rig()

    def _running(self) -> Runner:
        if self.runner is None:
            raise RuntimeError("the programme has not begun")
        return self.runner

    def _follow_requests(self) -> None:
        """Stop, resume, skip or pace from the first unpublished control cycle on."""
        runner = self._running()
        paced = self.pacer.follow(runner, self.next)
        if complaint := self.tally.counter.complaint or self.unwritten or paced:
            if runner.stop(self.next, complaint):
                self.get_logger().error(f"the programme stops: {complaint}")
            self.tally.counter.complaint = ""
        while self.requests:
            request = self.requests.pop(0)
            if request == "stop" and self._waits:
                runner.motions[-1] = runner.motions[-1]._replace(reason=ON_REQUEST)
                continue
            done = runner.stop(self.next, ON_REQUEST) if request == "stop" else getattr(runner, request)(self.next)
            self.get_logger().info(
                f"programme {request} from control cycle {self.next} on" if done else f"nothing to {request}"
            )

    def _publish_to(self, cycle: int) -> None:
        if cycle < self.next:
            return
        first = self.next
        # Saved before publishing: a successor after a kill sends these rows again, which changes nothing.
        self._save(cycle)
        self._send(first, cycle)
        self.next = cycle + 1

    def _send(self, first: int, last: int) -> None:
        """Publish control cycles, and keep the reference for comparison with their measurements."""
        rows = self._running().rows(first, last - first + 1)
        for cycle, (point, reference) in enumerate(zip(_entries(rows), rows.reference.tolist(), strict=True), start=first):
            stamp = self.epoch_ns + round(cycle * self.period_ns)
            self.points.send(stamp, cycle, *point)
            self.publish_actuator(stamp, cycle)
            self.outbox.send(stamp, cycle, *reference)
        self._remember(rows, first)

    def _remember(self, rows: Rows, first: int) -> None:
        """Keep the reference of control cycles for comparison with their measurements."""
        for cycle, (point, reference) in enumerate(
            zip(_entries(rows), rows.reference[:, 0].tolist(), strict=True), start=first
        ):
            if cycle >= self.tally.next:
                self.tally.samples[cycle] = (*point, reference)

    def _save(self, published: int, *, durable: bool = False) -> None:
        """Replace the state; ``durable`` only after the loop: a busy disk takes longer than the rig has reference."""
        runner = self._running()
        counting = self.tally.next if self.tally.counter.since is None else self.tally.counter.since
        # Of a load cycle with many motions, only those are needed whose snapshots the rig keeps.
        runner.forget(min(max(counting, self.last - DEPTH), self.next))
        seen = max(self.tally.next - 1, 0)
        if not self.rig.is_certain:
            self._identify_rig()
        p = self.programme.parameters
        tally = self.tally
        state = ProgrammeState(
            self.digest, p.hold, p.stop_time, p.hold_time, self.holds, self.rig.identifier, seen, published, counting,
            tally.counter.done, tuple(runner.motions), tally.counter.stiffness,
        )  # fmt: skip
        with self._writing():
            self.records.log.flush(durable=durable)
            self.file.write(plain(state), durable=durable)
            self.unwritten = ""

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Stop the programme if its records cannot be written: unrecorded load cycles do not count as tested."""
        try:
            yield
        except NotWritten as error:
            if not self.unwritten:
                self.get_logger().error(str(error))
            self.unwritten = str(error)

    def _count(self) -> None:
        """Read the new snapshots, and log the load cycles that they complete."""
        logged = False
        for message in self._snapshots():
            stamp, cycle = message[:2]
            known = self.tally.samples.pop(cycle, None)
            for missed in range(self.tally.next, cycle):
                self.tally.samples.pop(missed, None)
            self.tally.next = cycle + 1
            if known is None:
                continue
            block, repetition, load_cycles, phase, state, reference = known
            measured, position = message[2 + MEASURED[self.follows]], message[2 + sensors.POSITION]
            sample = Sample(cycle, block, repetition, load_cycles, phase, state, reference, measured, position)
            finished = self.tally.counter.add(sample)
            self.pacer.add(sample, finished)
            self.state, self.block = State(state), block
            if finished:
                self.records.log.add(finished, stamp / NANOSECONDS)
                self.tally.newest, logged = finished[-1], True
        if logged:
            with self._writing():
                self.records.log.flush()

    def _snapshots(self) -> list[tuple[Any, ...]]:
        """Return the snapshots of published control cycles that were not counted yet, in order."""
        found, self.tally.waiting = self.tally.waiting, []
        while (message := self.states.take()) is not None:
            found.append(message)
        # A rig in lockstep opens the control cycle for which it awaits reference.
        self.tally.waiting = [message for message in found if message[1] >= self.next]
        return [message for message in found if self.tally.next <= message[1] < self.next]

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the position in the programme."""
        programme = self.programme
        figures: dict[str, Any] = {
            "programme": programme.parameters.title,
            "programme_state": self.state.name.lower(),
            "block": self.block,
            "block_name": programme.leaves[self.block].name,
            "load_cycles": self.tally.counter.done,
            "of_load_cycles": programme.load_cycles,
            "cycle": self.last,
            "ahead": self.next - 1 - self.last,
        }
        if self.tally.newest is not None:
            figures |= {"peak": self.tally.newest.peak, "valley": self.tally.newest.valley, "unit": UNITS[self.follows]}
        runner = self.runner
        if runner is not None and runner.motions[-1].rests is not None and self.state != State.FINISHED:
            reason = runner.motions[-1].reason
            figures["stopped_because"] = reason
            if reason == WAITS:
                return OK, WAITS, figures
            then = AFTER_CLOSURE if self.valve_follows is False else "programme_resume continues"
            return OK if reason == ON_REQUEST else WARN, f"stopped: {reason}; {then}", figures
        if not self.is_active:
            return OK, "inactive", figures
        if runner is None and (other := self.owners.owner_of(REFERENCE_TOPICS[self.follows].name)):
            return WARN, f"waits to begin: {other} owns {self.outbox.topic}; deactivate or stop it", figures
        if self.pacer.remark:
            figures["pacing"] = self.pacer.remark
        return OK, self.pacer.remark or self.state.name.lower(), figures

    def _owner_of_reference(self) -> str | None:
        """Return the sender that owns the reference at present; None if the programme may begin."""
        while self.other is not None and self.other.take() is not None:
            pass
        return self.owners.owner_of(REFERENCE_TOPICS[self.follows].name)

    def _ignore_other_references(self) -> None:
        """Stop reading the reference of other nodes: the programme owns it now."""
        if self.other is not None:
            self.other.destroy()
            self.other = None


def _entries(rows: Rows) -> Iterator[tuple[int, int, int, float, int]]:
    """Yield block, repetition, load cycles, phase and state of each control cycle."""
    points = rows.points
    columns = (points.block, points.repetition, points.load_cycles, points.phase, rows.state)
    return zip(*(column.tolist() for column in columns), strict=True)


def main() -> NoReturn:
    """Run the node."""
    run_node(ProgrammeNode)


if __name__ == "__main__":
    main()
