"""Base of the plant nodes: topics, services, the safety gate, telemetry.

``plant_sim_node`` runs the simulator behind it, ``hardware_bridge_node`` a DAQ backend.
"""

import math
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, String

from ehls_msgs.msg import ChamberPressures, Driver, ForceReference, LoaderState, ValveCommand
from ehls_msgs.srv import SwitchController
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.hardware.gate_bounds import Bound
from ehls_ros.hardware.gate_parameters import Parameters as GateParameters
from ehls_ros.hardware.handover import PlantHandover, Succession
from ehls_ros.hardware.safety_gate import Gate, watched
from ehls_ros.hardware.stamps import Stamps
from ehls_ros.nodes.codec import decode_text
from ehls_ros.nodes.control import CLOCK_TOPIC, PATIENCE, ControlNode
from ehls_ros.nodes.diagnostics import OK, WARN
from ehls_ros.nodes.gate_services import GateServices
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.loop import WAIT
from ehls_ros.nodes.parameters import declare, values_of
from ehls_ros.nodes.telemetry import Telemetry, time_of
from ehls_ros.nodes.transport import Inbox, Notice, Outbox, Waiter, control_qos
from ehls_ros.physics.rig import CHAMBER_SENSED, SENSED
from ehls_ros.process import Stopping
from ehls_ros.recording.topics import CHAMBER_PRESSURES, DEPTH, DRIVER, DRIVING, IN_FULL, LEAVING, STANDBY_COMMAND
from ehls_ros.schema import quantity, text

CLOCK_CYCLES = 10
"""Cycles between two clock messages in lockstep; nodes that run ahead of the cycles follow the clock."""

CLOCK_CYCLES_COMPOSED = 100
"""The same where nodes share the plant's process: they are many times faster, and see each cycle."""

NOTICE = 2.0
"""Time for which diagnostics report a jump of the stamps [s]; the size of the last jump stays among the figures."""

ASK_AGAIN = 1.0
"""Time after which a partner that has not answered is queried again [s]."""

HANDOVER_DEPTH = 10
"""History depth of the driver and departure topics."""

STANDBY_PATIENCE = 10.0
"""Longest wait of a plant in lockstep for a standby controller [s]: a hung one must not stall it."""

KEPT = 4000
"""Maximum number of force references kept for future cycles."""


class Parameters(NamedTuple):
    """Parameters of every plant node."""

    cycles: Annotated[int, quantity("1", "cycles to run; 0: until stopped", minimum=0)] = 0
    telemetry_rate: Annotated[
        float, quantity("Hz", "rate of the messages for standard tools, such as joint_states", minimum=0.0, maximum=1e3)
    ] = 50.0
    take_over_after: Annotated[
        float,
        quantity(
            "s",
            "silence of the driving controller after which the one that stands by takes over, below command_timeout; 0: never",
            minimum=0.0,
            maximum=0.5,
        ),
    ] = 0.0
    partners: Annotated[str, text("nodes, separated by commas, that must be active before autostart activates this one")] = ""


@dataclass(slots=True)
class CycleStatistics:
    """Times and counts of the cycles. Times are those of :func:`time.perf_counter` [s].

    Attributes:
        begun: time of the start of the loop.
        opened: time of the newest snapshot.
        requested: the same, or of its last repetition.
        stamps_jumped: time of the last jump of the header stamps.
        missed: cycles without an answer in time.
        latency: response times of the controllers.
    """

    begun: float = field(default_factory=time.perf_counter)
    opened: float = field(default_factory=time.perf_counter)
    requested: float = 0.0
    stamps_jumped: float = -math.inf
    missed: int = 0
    latency: Latency = field(default_factory=Latency)

    @property
    def is_new(self) -> bool:
        """Whether the loop began less than :data:`PATIENCE` ago."""
        return time.perf_counter() - self.begun < PATIENCE


@dataclass(slots=True)
class Snapshot:
    """The newest published snapshot.

    Attributes:
        cycle: number of the cycle.
        time_s: its time [s].
        stamp_ns: header stamp [ns].
        signals: readings in the order of ``SENSED``.
    """

    cycle: int = 0
    time_s: float = 0.0
    stamp_ns: int = 0
    signals: Sequence[float] = ()


class DriverAnnouncements:
    """Publishes which controller drives from which cycle on, and whether commands reach the valve."""

    def __init__(self, node: ControlNode, handover: PlantHandover) -> None:
        """Open the topics; nothing is published yet."""
        self._node = node
        self._handover = handover
        self._driver = Notice(node, Driver, DRIVER.name, HANDOVER_DEPTH)
        self._driving = Notice(node, Bool, DRIVING.name, 1)
        self._all = Notice(node, Bool, IN_FULL.name, 1)
        self._is_driving: bool | None = None
        self._in_full: bool | None = None

    def publish_driver(self) -> None:
        """Publish the driver that the hand-over has decided on."""
        now, handover = self._node.get_clock().now(), self._handover
        values = handover.drives_from, bool(self._is_driving), handover.announced or "", self._node.sender
        message = Driver(cycle=values[0], driving=values[1], sender=values[2], plant=values[3])
        message.header.stamp = now.to_msg()
        self._driver.publish(message, (now.nanoseconds, *values))

    def publish_driving(self, *, driving: bool, in_full: bool) -> None:
        """Publish a change in whether commands reach the valve, since controllers in an open loop would wind up.

        Args:
            driving: whether they reach it.
            in_full: whether they reach it unchanged.
        """
        if in_full != self._in_full:
            self._in_full = in_full
            self._all.publish(Bool(data=in_full), in_full)
        if driving != self._is_driving:
            self._is_driving = driving
            self._driving.publish(Bool(data=driving), driving)
            if self._handover.announced is not None:
                self.publish_driver()

    def destroy(self) -> None:
        """Close the topics."""
        for notice in (self._driver, self._driving, self._all):
            notice.destroy()


class PlantNode(ControlNode):
    """Opens each cycle with a loader_state and passes the answers through the safety gate.

    Subclasses implement :meth:`once` and run the rig behind the gate.
    """

    gate_defaults: Mapping[str, Any] = MappingProxyType({})
    """Gate parameters that differ from the declared defaults; both are for the paper's rig."""

    gate_bounds: Mapping[str, Bound] | None = None
    """Bounds of the gate's parameters; None: set from the rig's limits."""

    def __init__(self, name: str) -> None:
        """Declare the parameters and the services; make the gate, which stays latched for the life of the node.

        Raises:
            BadInput: a parameter of the gate, or the rig's limits, are wrong.
        """
        super().__init__(name)
        declare(self, Parameters, live=False)
        self.cycles = int(self.get_parameter("cycles").value)
        self.answered = -1
        # Cycles with the valve closed since it was first open or a trip: they do not count towards `cycles`.
        self.closed_cycles = 0
        self.was_driving = False
        self.period = self.spec.settings.control_period
        rig, self.sensed = self.spec.rig, self.measured()
        seen = watched(self.sensed)
        sound = Gate(rig, self.period, None, seen, bounds=self.gate_bounds).parameters
        changed = tuned_for(GateParameters, rig, self.gate_defaults)._asdict()
        defaults = {**sound._asdict(), **{name: changed[name] for name in self.gate_defaults}}
        declare(self, GateParameters, defaults, live=True)
        self.awaited: tuple[str, ...] = ()
        self.gate = Gate(rig, self.period, values_of(self, GateParameters, name), seen, bounds=self.gate_bounds)
        self._gate_services = GateServices(self, self.gate, self.refusal)
        self._ending = self.create_timer(0.0, self._leave, autostart=False, clock=self.steady)
        # Made by `open_topics`:
        self.statistics: CycleStatistics
        self.handover: PlantHandover
        self.stamps: Stamps
        self.references: dict[int, float]
        self.snapshot: Snapshot
        self.announcements: DriverAnnouncements
        self.state: Outbox
        self.chambers: Outbox | None
        self.commands: Inbox
        self.answer: Waiter
        self.reference: Inbox
        self.standby_commands: Inbox
        self.standby_answer: Waiter
        self.departures: Inbox
        self.clock: Any
        self.telemetry: Telemetry
        self.create_service(SwitchController, "switch_controller", self._on_switch)

    def bring_up(self, stopping: Stopping) -> bool:
        """Configure; activate once the partners are active, so that the first cycle finds all who answer it."""
        if not self.lifecycle.configure():
            return False
        self.awaited = tuple(filter(None, self.text_parameter("partners").split(",")))
        states = {name: self.create_client(GetState, f"{name}/get_state") for name in self.awaited}
        while self.awaited and not self.is_active and not stopping.wait(WAIT):
            self.awaited = tuple(name for name in self.awaited if not self._is_partner_active(states[name]))
        self.awaited = ()
        return stopping.is_set() or self.lifecycle.activate()

    def _is_partner_active(self, client: Client) -> bool:
        """Query a node's state; repeat the request if the answer is late or lost."""
        if not client.wait_for_service(WAIT):
            return False
        answered = threading.Event()
        future = client.call_async(GetState.Request())
        future.add_done_callback(lambda _: answered.set())
        return answered.wait(ASK_AGAIN) and future.result().current_state.id == State.PRIMARY_STATE_ACTIVE

    def measured(self) -> Collection[str]:
        """Return the signals that the rig measures; called once, by the constructor."""
        raise NotImplementedError

    def open_topics(self) -> None:
        """Open the topics."""
        self.answered = -1
        self.closed_cycles, self.was_driving = 0, False
        self.statistics = CycleStatistics()
        self.stamps = Stamps(self.period)
        self.references = {}
        self.snapshot = Snapshot()
        timeout = self.gate.parameters.command_timeout / self.period
        # In lockstep the plant waits for each standby controller.
        patience = DEPTH if self.lockstep else math.ceil(0.5 * timeout)
        take_over_after = float(self.get_parameter("take_over_after").value)
        self.handover = PlantHandover(self.gate, grace=math.ceil(timeout), patience=patience, take_over_after=take_over_after)
        # Topics are discovered in this order: a reader of snapshots must already have the driver message.
        self.announcements = DriverAnnouncements(self, self.handover)
        self.state = Outbox(self, LoaderState, "loader_state", opens=True)
        both = set(CHAMBER_SENSED) <= set(self.sensed)
        self.chambers = Outbox(self, ChamberPressures, CHAMBER_PRESSURES.name) if both else None
        self.commands = Inbox(self, ValveCommand, "valve_command", owned="")
        self.reference = Inbox(self, ForceReference, "force_reference")
        self.answer = Waiter([self.commands])
        self.standby_commands = Inbox(self, ValveCommand, STANDBY_COMMAND.name, owned="")
        self.standby_answer = Waiter([self.standby_commands])
        self.departures = Inbox(self, String, LEAVING.name, control_qos(HANDOVER_DEPTH), decode_text)
        self.clock = self.create_publisher(Clock, CLOCK_TOPIC, control_qos(1)) if self.lockstep else None
        self.telemetry = Telemetry(self, float(self.get_parameter("telemetry_rate").value), self.sensed)

    def release(self) -> None:
        """Close the topics."""
        inboxes = self.commands, self.standby_commands, self.departures, self.reference
        for part in (self.answer, self.standby_answer, *inboxes, self.state, self.announcements, self.telemetry):
            part.destroy()
        if self.chambers is not None:
            self.chambers.destroy()
        if self.clock is not None:
            self.destroy_publisher(self.clock)

    def begin_stamps(self, cycle: int) -> None:
        """Start counting cycles: anchor the time stamps to the node's clock; in lockstep cycle 0 is at time 0.

        Args:
            cycle: the cycle that begins now.
        """
        self.statistics.begun = time.perf_counter()
        if not self.lockstep:
            self.stamps.begin(cycle, self.now_ns() or 0)

    def _stamp_of(self, cycle: int) -> int:
        """Return the stamp of a cycle that begins now [ns]."""
        jumps = self.stamps.jumps
        stamp_ns = self.stamps.of(cycle, None if self.lockstep else self.now_ns())
        if self.stamps.jumps != jumps:
            self.statistics.stamps_jumped = time.perf_counter()
        return stamp_ns

    def publish(self, cycle: int, signals: Sequence[float], **sample: Any) -> None:
        """Open a cycle: pass a snapshot to the gate and the graph.

        Args:
            cycle: its number.
            signals: readings in the order of ``SENSED``, and those of both chambers if the rig has them.
            sample: further arguments of :meth:`Gate.sense`.
        """
        self._decide_driver(cycle)
        while (message := self.reference.take()) is not None:
            self.references[message[1]] = message[2]
        if len(self.references) > KEPT:
            self.references = {k: force for k, force in self.references.items() if k >= cycle}
        in_snapshot = signals[: len(SENSED)]
        self.gate.sense(cycle, in_snapshot, self.references.pop(cycle, math.nan), **sample)
        stamp_ns = self._stamp_of(cycle)
        statistics = self.statistics
        statistics.opened = statistics.requested = time.perf_counter()
        self.handover.standby.cycle = cycle
        self.state.send(stamp_ns, cycle, *in_snapshot)
        if self.clock is not None and cycle % (CLOCK_CYCLES if self.links is None else CLOCK_CYCLES_COMPOSED) == 0:
            self.clock.publish(Clock(clock=time_of(stamp_ns)))
        snapshot = self.snapshot
        snapshot.cycle, snapshot.time_s, snapshot.stamp_ns, snapshot.signals = cycle, cycle * self.period, stamp_ns, signals

    def repeat_snapshot(self, cycle: int) -> None:
        """Repeat the present snapshot if its answer is overdue and either may have been sent too early.

        A node with ROS's default profile receives no message sent before it was matched, and messages that it sends earlier are
        lost: a plant in lockstep would wait for its answer forever.
        """
        if time.perf_counter() - self.statistics.requested > PATIENCE:
            self.statistics.requested = time.perf_counter()
            self._decide_driver(cycle + (self.answered >= cycle))
            if self.commands.volatile or self.state.has_volatile_reader():
                self.state.send(self.snapshot.stamp_ns, cycle, *self.snapshot.signals[: len(SENSED)])

    def publish_telemetry(self) -> None:
        """Publish the chambers' pressures, and telemetry if due; called after the answer, so that it is not delayed."""
        snapshot = self.snapshot
        if self.chambers is not None:
            self.chambers.send(snapshot.stamp_ns, snapshot.cycle, *snapshot.signals[len(SENSED) :])
        self.telemetry.publish(snapshot.time_s, snapshot.stamp_ns, snapshot.signals)

    def take_commands(self, cycle: int) -> None:
        """Pass the received commands to the gate.

        Args:
            cycle: the present cycle.
        """
        while (message := self.commands.take()) is not None:
            _, answered, spool, sender = message
            if answered > cycle and self.statistics.is_new:
                # Transient-local message of an earlier run: the controller answered another plant's cycle.
                continue
            if self.handover.take(sender, answered, spool, cycle) and self.answered < answered <= cycle:
                self.answered = answered
                if answered == cycle:
                    self.statistics.latency.add(time.perf_counter() - self.statistics.opened)
        self._take_standby_commands()
        while (sender := self.departures.take()) is not None:
            if (succession := self.handover.end(sender)) is not None:
                self._log_succession(succession)
                self._decide_driver(cycle + (self.answered >= cycle))

    def _take_standby_commands(self) -> None:
        while (message := self.standby_commands.take()) is not None:
            self.handover.note_standby(message[3], message[1])

    def standby_answered(self) -> bool:
        """Return whether all standby controllers have followed the present cycle; wait briefly if not.

        In lockstep the plant waits for them too, so that a run with a hand-over remains deterministic.
        """
        self._take_standby_commands()
        if not (behind := self.handover.standby.behind):
            return True
        if time.perf_counter() - self.statistics.opened > STANDBY_PATIENCE:
            for sender in behind:
                self.handover.standby.remove(sender)
            return True
        self.standby_answer.wait(WAIT)
        return False

    def _decide_driver(self, cycle: int) -> None:
        """Publish which controller drives from a cycle on, if that has changed."""
        handover = self.handover
        if handover.take_over_after > 0.0 and (succession := handover.replace_silent()) is not None:
            self._log_succession(succession)
        if handover.decide(cycle):
            self.announcements.publish_driver()

    def _log_succession(self, succession: Succession) -> None:
        if succession.expected:
            self.get_logger().info(succession.text)
        else:
            self.get_logger().warning(succession.text)

    def have_all_run(self, cycles: int, elapsed: int = 1) -> bool:
        """Return whether the cycles to run are done; while a trip or an operator keeps the valve closed, none is.

        Args:
            cycles: cycles so far.
            elapsed: of these, the cycles since the last call.
        """
        self.was_driving |= self.gate.driving
        if self.gate.causes or (self.was_driving and not self.gate.driving):
            self.closed_cycles += elapsed
        return 0 < self.cycles <= cycles - self.closed_cycles

    def end_cycles(self) -> None:
        """Leave the active state from the service thread: the last cycle is done."""
        self.loop.withdraw()
        self._ending.reset()

    def _leave(self) -> None:
        self._ending.cancel()
        self.trigger_deactivate()

    def note_service_silence(self, silence: float) -> None:
        """Report to the gate how long an emergency stop could not be received; in lockstep the rig's time may stand still."""
        if not self.lockstep:
            self.gate.set_service_silence(silence)

    def report_gate(self) -> None:
        """Publish diagnostics if the gate's state has changed."""
        self._gate_services.report_change()

    def _beat(self) -> None:
        super()._beat()
        self.report_gate()

    def _on_switch(self, request: SwitchController.Request, response: SwitchController.Response) -> SwitchController.Response:
        try:
            response.success, response.message = True, self.handover.request(request.controller)
        except BadInput as error:
            response.success, response.message = False, str(error)
        self.get_logger().info(f"switch: {response.message}")
        return response

    def refusal(self) -> str | None:
        """Return why the gate must stay closed, for reasons outside the gate; None if it may open."""
        return None

    def advice(self) -> str:
        """Return the commands that resume operation after a trip, for the log."""
        return self._gate_services.advice()

    def figures(self) -> dict[str, Any]:
        """Return values for diagnostics; subclasses add theirs."""
        statistics = self.statistics
        counts = {"cycles": self.cycles, "closed_cycles": self.closed_cycles, "missed": statistics.missed}
        return {**counts, **self.stamps.figures(), **statistics.latency.figures()}

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the gate's state; if that is OK, the state of the cycles."""
        level, state, figures = self.gate.health()
        figures = {**self.figures(), **figures}
        if level:
            return bytes([level]), state, figures
        if not self.is_active:
            return (WARN, f"waiting for {', '.join(self.awaited)}", figures) if self.awaited else (OK, "inactive", figures)
        complaint = self._complaint()
        return (WARN, complaint, figures) if complaint else (OK, state, figures)

    def _complaint(self) -> str:
        """Return the fault of the answers or the clock; empty if there is none."""
        if self.lockstep and self.count_publishers(CLOCK_TOPIC) > 1:
            return f"another node publishes {CLOCK_TOPIC}: start one of the two graphs with -r {CLOCK_TOPIC}:=/another/name"
        if self.lockstep and time.perf_counter() - self.statistics.opened > PATIENCE:
            return "waiting for the controller's answer or the disturbance"
        if time.perf_counter() - self.statistics.stamps_jumped < NOTICE:
            return f"header stamps jumped by {self.stamps.jump:+.3f} s to the clock's: the process slept, or the clock was set"
        if self.answered < 0 and not self.statistics.is_new:
            return "no controller has answered yet"
        return "cycles without an answer: the last command was held" if self.statistics.missed else ""
