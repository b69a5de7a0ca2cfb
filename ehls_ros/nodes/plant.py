"""Base of the plant nodes: topics, services, the safety gate, telemetry.

``plant_sim_node`` runs the simulator behind it, ``hardware_bridge_node`` a DAQ backend.
"""

import math
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.msg import Driver, ForceReference, LoaderState, ValveCommand
from ehls_msgs.srv import AcknowledgeStop, SwitchController
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.hardware.gate_bounds import Bound
from ehls_ros.hardware.gate_parameters import Parameters as GateParameters
from ehls_ros.hardware.safety_gate import STOP_TIME, Gate
from ehls_ros.hardware.stamps import Stamps
from ehls_ros.hardware.standby import Standby, is_of
from ehls_ros.nodes.codec import decode_text
from ehls_ros.nodes.control import CLOCK_TOPIC, OK, PATIENCE, WAIT, WARN, ControlNode
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.parameters import declare, follow, values_of
from ehls_ros.nodes.telemetry import Telemetry, time_of
from ehls_ros.nodes.transport import Inbox, Notice, Outbox, Waiter, control_qos
from ehls_ros.process import Stopping
from ehls_ros.recording.topics import DEPTH, DRIVER, DRIVING, LEAVING, STANDBY_COMMAND
from ehls_ros.schema import quantity, text

CLOCK_CYCLES = 10
"""Cycles between two clock messages in lockstep; nodes that run ahead of the cycles follow the clock."""

CLOCK_CYCLES_TOGETHER = 100
"""Cycles between two clock messages where nodes share the plant's process: they are many times faster and see each cycle."""

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
        self.period = self.spec.settings.control_period
        rig, self.sensed = self.spec.rig, self.measured()
        sound = Gate(rig, self.period, None, self.sensed, bounds=self.gate_bounds).parameters
        changed = tuned_for(GateParameters, rig, self.gate_defaults)._asdict()
        defaults = {**sound._asdict(), **{name: changed[name] for name in self.gate_defaults}}
        declare(self, GateParameters, defaults, live=True)
        self.awaited: tuple[str, ...] = ()
        self.take_over_after = float(self.get_parameter("take_over_after").value)
        # The next driver; the last driver that left or fell silent.
        self.successor = self.gone = ""
        self.gate = Gate(rig, self.period, values_of(self, GateParameters, name), self.sensed, bounds=self.gate_bounds)
        self.told_gate: tuple[str, int] | None = None
        follow(self, GateParameters, self._retune, self.gate.objection)
        self._ending = self.create_timer(0.0, self._leave, autostart=False, clock=self.steady)
        self.create_service(Trigger, "emergency_stop", self._on_emergency_stop)
        self.create_service(AcknowledgeStop, "acknowledge_stop", self._on_acknowledge)
        self.create_service(Trigger, "reset_trips", self._on_reset)
        self.create_service(SetBool, "enable", self._on_enable)
        self.create_service(SwitchController, "switch_controller", self._on_switch)

    def bring_up(self, stopping: Stopping) -> bool:
        """Configure; activate once the partners are active, so that the first cycle finds all who answer it."""
        if not self.configure_itself():
            return False
        self.awaited = tuple(filter(None, self.text_parameter("partners").split(",")))
        states = {name: self.create_client(GetState, f"{name}/get_state") for name in self.awaited}
        while self.awaited and not self._active.is_set() and not stopping.wait(WAIT):
            self.awaited = tuple(name for name in self.awaited if not self._is_active(states[name]))
        self.awaited = ()
        return stopping.is_set() or self.activate_itself()

    def _is_active(self, client: Client) -> bool:
        """Query a node's state; repeat the request if the answer is late or lost."""
        if not client.wait_for_service(WAIT):
            return False
        answered = threading.Event()
        future = client.call_async(GetState.Request())
        future.add_done_callback(lambda _: answered.set())
        return answered.wait(ASK_AGAIN) and future.result().current_state.id == State.PRIMARY_STATE_ACTIVE

    def measured(self) -> Collection[str]:
        """Return the signals of ``SENSED`` that the rig measures; called once, by the constructor."""
        raise NotImplementedError

    def open_topics(self) -> None:
        """Open the topics."""
        self.answered = -1
        self.missed = 0
        self.references: dict[int, float] = {}
        self.latency = Latency()
        self.published = self.begun = time.perf_counter()
        # Topics are discovered in this order: a reader of snapshots must already have the driver message.
        self.driver = Notice(self, Driver, DRIVER.name, HANDOVER_DEPTH)
        self.state = Outbox(self, LoaderState, "loader_state", opens=True)
        self.commands = Inbox(self, ValveCommand, "valve_command", owned="")
        self.reference = Inbox(self, ForceReference, "force_reference")
        self.answer = Waiter([self.commands])
        # In lockstep the plant waits for each standby controller it has heard from.
        timeout = math.ceil(0.5 * self.gate.parameters.command_timeout / self.period)
        self.standby = Standby(DEPTH if self.lockstep else timeout)
        self.shadows = Inbox(self, ValveCommand, STANDBY_COMMAND.name, owned="")
        self.shadow = Waiter([self.shadows])
        self.leaving = Inbox(self, String, LEAVING.name, control_qos(HANDOVER_DEPTH), decode_text)
        self.told_driver: str | None = None
        self.drives_from = 0
        # First cycle answered by the driving controller; last cycle that others may answer unaware of it; this grace period.
        self.first = 0
        self.unaware = -1
        self.grace = math.ceil(self.gate.parameters.command_timeout / self.period)
        self.driving = Notice(self, Bool, DRIVING.name, 1)
        self.told_driving: bool | None = None
        self.clock = self.create_publisher(Clock, CLOCK_TOPIC, control_qos(1)) if self.lockstep else None
        self.clock_cycles = CLOCK_CYCLES if self.links is None else CLOCK_CYCLES_TOGETHER
        self.stamps = Stamps(self.period)
        self.jumped = -math.inf
        self.telemetry = Telemetry(self, float(self.get_parameter("telemetry_rate").value), self.sensed)

    def release(self) -> None:
        """Close the topics."""
        inboxes = self.commands, self.shadows, self.leaving, self.reference
        for part in (self.answer, self.shadow, *inboxes, self.state, self.driver, self.driving, self.telemetry):
            part.destroy()
        if self.clock is not None:
            self.destroy_publisher(self.clock)

    def begin_stamps(self, cycle: int) -> None:
        """Start counting cycles: anchor the time stamps to the node's clock; in lockstep cycle 0 is at time 0.

        Args:
            cycle: the cycle that begins now.
        """
        self.begun = time.perf_counter()
        if not self.lockstep:
            self.stamps.begin(cycle, self.now_ns() or 0)

    def _stamp_of(self, cycle: int) -> int:
        """Return the stamp of a cycle that begins now [ns]."""
        jumps = self.stamps.jumps
        stamp_ns = self.stamps.of(cycle, None if self.lockstep else self.now_ns())
        if self.stamps.jumps != jumps:
            self.jumped = time.perf_counter()
        return stamp_ns

    def publish(self, cycle: int, signals: Sequence[float], **sample: Any) -> None:
        """Open a cycle: pass a snapshot to the gate and the graph.

        Args:
            cycle: its number.
            signals: readings in the order of ``SENSED``.
            sample: further arguments of :meth:`Gate.sense`.
        """
        self._change_driver(cycle)
        while (message := self.reference.take()) is not None:
            self.references[message[1]] = message[2]
        if len(self.references) > KEPT:
            self.references = {k: force for k, force in self.references.items() if k >= cycle}
        self.gate.sense(cycle, signals, self.references.pop(cycle, math.nan), **sample)
        stamp_ns = self._stamp_of(cycle)
        self.published = time.perf_counter()
        self.asked = self.published
        self.standby.cycle = cycle
        self.state.send(stamp_ns, cycle, *signals)
        if self.clock is not None and cycle % self.clock_cycles == 0:
            self.clock.publish(Clock(clock=time_of(stamp_ns)))
        self.pending_telemetry = (cycle * self.period, stamp_ns, signals)

    def ask_again(self, cycle: int) -> None:
        """Repeat the present snapshot if its answer is overdue and either may have been sent too early.

        A node with ROS's default profile receives no message sent before it was matched, and messages that it sends earlier are
        lost: a plant in lockstep would wait for its answer forever.
        """
        if time.perf_counter() - self.asked > PATIENCE:
            self.asked = time.perf_counter()
            self._change_driver(cycle + (self.answered >= cycle))
            if self.commands.volatile or self.state.has_volatile_reader():
                _, stamp_ns, signals = self.pending_telemetry
                self.state.send(stamp_ns, cycle, *signals)

    def tell_telemetry(self) -> None:
        """Publish telemetry of the cycle if due; called after the answer, so that the answer is not delayed."""
        self.telemetry.tell(*self.pending_telemetry)

    def tell_driving(self, driving: bool) -> None:
        """Publish a change in whether commands reach the valve, since controllers in an open loop would wind up."""
        if driving != self.told_driving:
            self.told_driving = driving
            self.driving.tell(Bool(data=driving), driving)
            if self.told_driver is not None:
                self._publish_driver()

    def take_commands(self, cycle: int) -> None:
        """Pass the received commands to the gate.

        Args:
            cycle: the present cycle.
        """
        while (message := self.commands.take()) is not None:
            _, answered, spool, sender = message
            if answered > cycle and self._is_new:
                # Transient-local message of an earlier run: the controller answered another plant's cycle.
                continue
            if self._came_second(sender, answered):
                if not self.told_driver:
                    # That controller stands by from the next cycle on.
                    self.standby.hear(sender, answered)
                continue
            before = self.gate.owner
            self.gate.take(answered, spool, sender)
            if self.gate.owner != before:
                self.first = min(answered, cycle)
            # A command of the gate's owner is an answer even if the gate refuses it.
            if sender == self.gate.owner and self.answered < answered <= cycle:
                self.answered = answered
                if answered == cycle:
                    self.latency.add(time.perf_counter() - self.published)
        self._hear_shadows()
        while (sender := self.leaving.take()) is not None:
            self.standby.forget(sender)
            if sender == self.gate.owner:
                self._succeed(sender, "leaves")
                self._change_driver(cycle + (self.answered >= cycle))

    @property
    def _is_new(self) -> bool:
        """Whether the first cycle was less than :data:`PATIENCE` ago."""
        return time.perf_counter() - self.begun < PATIENCE

    def _came_second(self, sender: str, answered: int) -> bool:
        """Return whether a command's sender could not yet know that another controller answered first and now drives."""
        owner = self.gate.owner
        if owner in {None, sender} or self.gate.vacant:
            return False
        return not self.told_driver or answered <= self.unaware

    def _hear_shadows(self) -> None:
        while (message := self.shadows.take()) is not None:
            if message[3] != self.gate.owner:
                self.standby.hear(message[3], message[1])

    def standby_answered(self) -> bool:
        """Return whether all standby controllers have followed the present cycle; wait briefly if not.

        In lockstep the plant waits for them too, so that a run with a hand-over remains deterministic.
        """
        self._hear_shadows()
        if not (behind := self.standby.behind):
            return True
        if time.perf_counter() - self.published > STANDBY_PATIENCE:
            for sender in behind:
                self.standby.forget(sender)
            return True
        self.shadow.wait(WAIT)
        return False

    def _succeed(self, owner: str, why: str) -> None:
        """Let the standby controller take over; with none, or several, the gate reacts to the lack of commands."""
        ready = [sender for sender in self.standby.ready if sender != owner]
        self.gone = owner
        self.successor = ready[0] if len(ready) == 1 else ""
        if not ready:
            # Every run with one controller ends like this.
            self.get_logger().info(f"{owner} {why}; no other controller stands by")
            return
        takes_over = self.successor or f"nobody takes over: {len(ready)} controllers stand by, one is needed"
        self.get_logger().warning(f"{owner} {why}; {takes_over}{' takes over' if self.successor else ''}")

    def _change_driver(self, cycle: int) -> None:
        """Hand over to the successor, if any, and publish which controller the gate obeys from a cycle on."""
        if self.take_over_after > 0.0 and not self.successor and self.gate.driving:
            silence, owner = self.gate.command_age, self.gate.owner
            if owner and silence >= self.take_over_after and self.standby.ready:
                self._succeed(owner, f"has been silent for {silence:.3f} s")
        if self.successor:
            before = self.gate.owner
            self.gate.hand_over(self.successor)
            if before and before != self.gone and cycle > self.standby.cycle:
                # The former driver stands by from the other's first cycle on, and is waited for like any standby controller.
                self.standby.hear(before, cycle - 1)
            self.successor, self.gone, self.first = "", "", cycle
        driver = "" if self.gate.vacant else self.gate.owner
        if driver is not None and driver != self.told_driver:
            if driver and not self.told_driver:
                # Until now the others answered too.
                self.unaware = cycle + self.grace
            self.told_driver = driver
            self.standby.forget(driver)
            self.drives_from = self.first if driver else cycle
            self._publish_driver()

    def _publish_driver(self) -> None:
        """Publish which controller drives from which cycle on, and whether its commands reach the valve."""
        now = self.get_clock().now()
        said = self.drives_from, bool(self.told_driving), self.told_driver or "", self.sender
        message = Driver(cycle=said[0], driving=said[1], sender=said[2], plant=said[3])
        message.header.stamp = now.to_msg()
        self.driver.tell(message, (now.nanoseconds, *said))

    def end_cycles(self) -> None:
        """Leave the active state from the service thread: the last cycle is done."""
        self.finish()
        self._ending.reset()

    def _leave(self) -> None:
        self._ending.cancel()
        self.trigger_deactivate()

    def _retune(self, parameters: GateParameters) -> None:
        for change in self.gate.retune(parameters):
            self.get_logger().warning(f"safety gate: {change}")
        self.report()

    def unheard(self, silence: float) -> None:
        """Report to the gate how long an emergency stop could not be received; in lockstep the rig's time may stand still."""
        if not self.lockstep:
            self.gate.set_service_silence(silence)

    def _beat(self) -> None:
        """Publish diagnostics as soon as the gate's state has changed: a trip must not be missed between two reports."""
        super()._beat()
        gate = self.gate.state, len(self.gate.causes)
        if gate != self.told_gate:
            self.told_gate = gate
            # The message may concern something else and be unchanged.
            self.report()

    def _on_emergency_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        stop = self.gate.emergency_stop()
        return self._answered(response, None, f"{stop}; after {STOP_TIME:g} s acknowledge_stop {stop}, reset_trips and enable")

    def _on_acknowledge(self, request: AcknowledgeStop.Request, response: AcknowledgeStop.Response) -> AcknowledgeStop.Response:
        return self._answered(response, self.gate.acknowledge(request.stop), "acknowledged; reset_trips, then enable to go on")

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answered(response, self.gate.reset(), "reset; enable to go on")

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if not request.data:
            self.gate.disable()
            return self._answered(response, None, "disabled")
        return self._answered(response, self.refusal() or self.gate.enable(), "enabled")

    def _on_switch(self, request: SwitchController.Request, response: SwitchController.Response) -> SwitchController.Response:
        owner = self.gate.owner or ""
        if request.controller and (request.controller == owner or is_of(owner, request.controller)):
            response.success, response.message = True, f"{owner} drives already"
            return response
        try:
            self.successor = self.standby.named(request.controller)
            response.success, response.message = True, f"{self.successor} takes over"
        except BadInput as error:
            response.message = str(error)
        self.get_logger().info(f"switch: {response.message}")
        return response

    def refusal(self) -> str | None:
        """Return why the gate must stay closed, for reasons outside the gate; None if it may open."""
        return None

    def advice(self) -> str:
        """Return the commands that resume operation after a trip, for the log."""
        if not self.gate.causes:
            return ""
        call, stop = f"ros2 service call {self.get_namespace().rstrip('/')}", self.gate.stop
        acknowledge = [f'{call}/acknowledge_stop ehls_msgs/srv/AcknowledgeStop "{{stop: {stop}}}"'] if stop else []
        reset = [f"{call}/reset_trips std_srvs/srv/Trigger", f'{call}/enable std_srvs/srv/SetBool "{{data: true}}"']
        return f": {' && '.join([*acknowledge, *reset])}"

    def _answered(self, response: Any, refusal: str | None, message: str) -> Any:
        """Fill in a service's response, and publish diagnostics at once."""
        response.success, response.message = refusal is None, refusal or message
        self.get_logger().info(f"safety gate: {response.message}")
        self.report()
        return response

    def figures(self) -> dict[str, Any]:
        """Return values for diagnostics; subclasses add theirs."""
        return {"cycles": self.cycles, "missed": self.missed, **self.stamps.figures(), **self.latency.figures()}

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the gate's state; if that is OK, the state of the cycles."""
        level, state, figures = self.gate.health()
        figures = {**self.figures(), **figures}
        if level:
            return bytes([level]), state, figures
        if not self._active.is_set():
            return (WARN, f"waiting for {', '.join(self.awaited)}", figures) if self.awaited else (OK, "inactive", figures)
        complaint = self._complaint()
        return (WARN, complaint, figures) if complaint else (OK, state, figures)

    def _complaint(self) -> str:
        """Return the fault of the answers or the clock; empty if there is none."""
        if self.lockstep and self.count_publishers(CLOCK_TOPIC) > 1:
            return f"another node publishes {CLOCK_TOPIC}: start one of the two graphs with -r {CLOCK_TOPIC}:=/another/name"
        if self.lockstep and time.perf_counter() - self.published > PATIENCE:
            return "waiting for the controller's answer or the disturbance"
        if time.perf_counter() - self.jumped < NOTICE:
            return f"header stamps jumped by {self.stamps.jump:+.3f} s to the clock's: the process slept, or the clock was set"
        if self.answered < 0 and not self._is_new:
            return "no controller has answered yet"
        return "cycles without an answer: the last command was held" if self.missed else ""
