"""What stands for the rig in the graph, simulated or real: topics, services, the safety gate, telemetry.

``plant_sim_node`` and ``hardware_bridge_node`` are this node with a simulator and with a DAQ backend behind it.
"""

import math
import time
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from ehls_msgs.msg import ForceReference, LoaderState, ValveCommand
from ehls_msgs.srv import AcknowledgeStop
from ehls_ros.hardware.gate_bounds import Bound
from ehls_ros.hardware.gate_parameters import Parameters as GateParameters
from ehls_ros.hardware.safety_gate import STOP_TIME, Gate
from ehls_ros.nodes.codec import NANOSECONDS, Decoder
from ehls_ros.nodes.control import OK, WARN, ControlNode
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.parameters import declare, follow, values_of
from ehls_ros.nodes.telemetry import Telemetry, time_of
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, control_qos
from ehls_ros.recording.topics import DRIVING
from ehls_ros.schema import quantity

CLOCK_CYCLES = 10
"""In lockstep the clock tells the cycles' time every so many cycles; what runs ahead of the cycles goes by it."""

PATIENCE = 1.0
"""Time without an answer after which diagnostics say so [s]."""

KEPT = 4000
"""Force references kept ahead of their cycle."""


class Parameters(NamedTuple):
    """How the cycles are run."""

    cycles: Annotated[int, quantity("1", "cycles to run; 0: until told to stop", minimum=0)] = 0
    telemetry_rate: Annotated[
        float, quantity("Hz", "rate of force, load_pressure and joint_states", minimum=0.0, maximum=1e3)
    ] = 50.0


class PlantNode(ControlNode):
    """Opens each cycle with a loader_state, takes the answers, and lets them through the safety gate.

    Subclasses implement :meth:`once` and run the rig behind the gate.
    """

    gate_defaults: Mapping[str, Any] = MappingProxyType({})
    """Values of the gate's parameters in place of the declared ones."""

    gate_bounds: Mapping[str, Bound] | None = None
    """What the gate's parameters may be; None: what the rig stands."""

    def __init__(self, name: str) -> None:
        """Declare the parameters and the services; make the gate, which latches for as long as the node lives.

        Raises:
            BadInput: a parameter of the gate, or the rig's limits, are wrong.
        """
        super().__init__(name)
        declare(self, Parameters, live=False)
        self.cycles = int(self.get_parameter("cycles").value)
        self.period = self.spec.settings.control_period
        rig, measured = self.spec.rig, self.measured()
        sound = Gate(rig, self.period, None, measured, bounds=self.gate_bounds).parameters
        declare(self, GateParameters, {**sound._asdict(), **self.gate_defaults}, live=True)
        self.gate = Gate(rig, self.period, values_of(self, GateParameters, name), measured, bounds=self.gate_bounds)
        follow(self, GateParameters, self._retune, self.gate.objection)
        self._ending = self.create_timer(0.0, self._leave, autostart=False)
        self.create_service(Trigger, "emergency_stop", self._on_emergency_stop)
        self.create_service(AcknowledgeStop, "acknowledge_stop", self._on_acknowledge)
        self.create_service(Trigger, "reset_trips", self._on_reset)
        self.create_service(SetBool, "enable", self._on_enable)

    def measured(self) -> Collection[str]:
        """Return the signals of ``SENSED`` that the rig measures; asked once, while the node is made."""
        raise NotImplementedError

    def open_topics(self) -> None:
        """Open the topics."""
        self.answered = -1
        self.missed = 0
        self.references: dict[int, float] = {}
        self.latency = Latency()
        self.published = time.perf_counter()
        self.state = Outbox(self, LoaderState, "loader_state", frame_id="loader")
        # A command from before this node was there is none for its cycles.
        self.commands = Inbox(self, ValveCommand, "valve_command", decode=Decoder(ValveCommand, frame=True))
        self.reference = Inbox(self, ForceReference, "force_reference")
        self.answer = Waiter([self.commands])
        self.driving = self.create_publisher(Bool, DRIVING.name, control_qos(1))
        self.told_driving: bool | None = None
        self.clock = self.create_publisher(Clock, self.clock_topic, control_qos(1)) if self.lockstep else None
        self.telemetry = Telemetry(self, float(self.get_parameter("telemetry_rate").value))

    def release(self) -> None:
        """Close the topics."""
        for part in (self.answer, self.commands, self.reference, self.state):
            part.destroy()
        self.telemetry.destroy()
        self.destroy_publisher(self.driving)
        if self.clock is not None:
            self.destroy_publisher(self.clock)

    def set_epoch(self, cycle: int) -> None:
        """Let stamps go by the clock of the wall from now, or in lockstep by the cycles alone.

        Args:
            cycle: the cycle that begins now.
        """
        self.epoch_ns = 0 if self.lockstep else time.time_ns() - cycle * round(self.period * NANOSECONDS)

    def publish(self, cycle: int, signals: Sequence[float], **sample: Any) -> None:
        """Open a cycle: show the gate and the graph a snapshot.

        Args:
            cycle: its number.
            signals: readings in the order of ``SENSED``.
            sample: what else :meth:`Gate.sense` is told of it.
        """
        while (message := self.reference.take()) is not None:
            self.references[message[1]] = message[2]
        if len(self.references) > KEPT:
            self.references = {k: force for k, force in self.references.items() if k >= cycle}
        self.gate.sense(cycle, signals, self.references.pop(cycle, math.nan), **sample)
        stamp_ns = self.epoch_ns + round(cycle * self.period * NANOSECONDS)
        self.published = time.perf_counter()
        self.state.send(stamp_ns, cycle, *signals)
        if self.clock is not None and cycle % CLOCK_CYCLES == 0:
            self.clock.publish(Clock(clock=time_of(stamp_ns)))
        self.untold = (cycle * self.period, stamp_ns, signals)

    def tell_telemetry(self) -> None:
        """Publish telemetry of the cycle, if it is due: once the cycle has been answered, so that it is in nobody's way."""
        self.telemetry.tell(*self.untold)

    def tell_driving(self, driving: bool) -> None:
        """Tell the controllers whether their commands reach the valve, when that changes: a loop that is open winds up."""
        if driving != self.told_driving:
            self.told_driving = driving
            self.driving.publish(Bool(data=driving))

    def take_commands(self, cycle: int) -> None:
        """Hand the gate what came in.

        Args:
            cycle: the cycle under way.
        """
        while (message := self.commands.take()) is not None:
            _, sender, answered, spool = message
            self.gate.take(answered, spool, sender)
            # What the gate refuses is an answer as well, if it is of whoever is to answer.
            if sender == self.gate.owner and self.answered < answered <= cycle:
                self.answered = answered
                if answered == cycle:
                    self.latency.add(time.perf_counter() - self.published)

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
        """Show the gate that nobody could stop the rig."""
        self.gate.hear(silence)

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

    def refusal(self) -> str | None:
        """Return why the gate must not be opened now, for reasons that the gate does not know of; None: nothing."""
        return None

    def _answered(self, response: Any, refusal: str | None, message: str) -> Any:
        """Fill a service's response, and tell diagnostics at once."""
        response.success, response.message = refusal is None, refusal or message
        self.report_change()
        return response

    def figures(self) -> dict[str, Any]:
        """Return figures for diagnostics; subclasses add theirs."""
        return {"cycles": self.cycles, "missed": self.missed, **self.latency.figures()}

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Say what the gate says, or else how the cycles go."""
        level, state, figures = self.gate.health()
        figures = {**self.figures(), **figures}
        if level:
            return bytes([level]), state, figures
        if not self._active.is_set():
            return OK, "inactive", figures
        complaint = self._complaint()
        return (WARN, complaint, figures) if complaint else (OK, state, figures)

    def _complaint(self) -> str:
        """Return what is wrong with the answers; nothing where nothing is."""
        if self.lockstep and time.perf_counter() - self.published > PATIENCE:
            return "waiting for the controller's answer or the disturbance"
        if self.answered < 0:
            return "no controller has answered yet"
        return "cycles without an answer: the last command was held" if self.missed else ""
