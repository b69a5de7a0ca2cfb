"""The services of a plant's safety gate, its live parameters, and the reports of its state."""

from collections.abc import Callable
from typing import Any

from std_srvs.srv import SetBool, Trigger

from ehls_msgs.srv import AcknowledgeStop
from ehls_ros.hardware.gate_parameters import Parameters
from ehls_ros.hardware.safety_gate import POSITION_CONTROL, STOP_TIME, Gate
from ehls_ros.nodes.control import ControlNode
from ehls_ros.nodes.parameters import follow


class GateServices:
    """Serves requests to a safety gate; each is logged, and diagnostics follow at once."""

    def __init__(self, node: ControlNode, gate: Gate, refusal: Callable[[], str | None]) -> None:
        """Offer the services.

        Args:
            node: owner, on which the gate's parameters are declared live.
            gate: the gate.
            refusal: returns why the gate must stay closed, for reasons outside the gate; None if it may open.
        """
        self._node = node
        self._gate = gate
        self._refusal = refusal
        self._reported: tuple[str, int] | None = None
        follow(node, Parameters, self._retune, gate.objection)
        node.create_service(Trigger, "emergency_stop", self._on_emergency_stop)
        node.create_service(AcknowledgeStop, "acknowledge_stop", self._on_acknowledge)
        node.create_service(Trigger, "unload", self._on_unload)
        node.create_service(Trigger, "reset_trips", self._on_reset)
        node.create_service(SetBool, "enable", self._on_enable)

    def report_change(self) -> None:
        """Publish diagnostics if the gate's state has changed: a trip must not be missed between two reports."""
        state = self._gate.state, len(self._gate.causes)
        if state != self._reported:
            self._reported = state
            # The message may concern something else and be unchanged.
            self._node.report()

    def advice(self) -> str:
        """Return the commands that resume operation after a trip, for the log; empty without a trip."""
        if not self._gate.causes:
            return ""
        call, stop = f"ros2 service call {self._node.get_namespace().rstrip('/')}", self._gate.stop
        acknowledge = [f'{call}/acknowledge_stop ehls_msgs/srv/AcknowledgeStop "{{stop: {stop}}}"'] if stop else []
        unload = [f"{call}/unload std_srvs/srv/Trigger"] if self._gate.state == POSITION_CONTROL else []
        reset = [f"{call}/reset_trips std_srvs/srv/Trigger", f'{call}/enable std_srvs/srv/SetBool "{{data: true}}"']
        return f": {' && '.join([*acknowledge, *unload, *reset])}"

    def _retune(self, parameters: Parameters) -> None:
        for change in self._gate.retune(parameters):
            self._node.get_logger().warning(f"safety gate: {change}")
        self._node.report()

    def _on_emergency_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        stop = self._gate.emergency_stop()
        return self._answered(response, None, f"{stop}; after {STOP_TIME:g} s acknowledge_stop {stop}, reset_trips and enable")

    def _on_acknowledge(self, request: AcknowledgeStop.Request, response: AcknowledgeStop.Response) -> AcknowledgeStop.Response:
        return self._answered(response, self._gate.acknowledge(request.stop), "acknowledged; reset_trips, then enable to go on")

    def _on_unload(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        then = "reset_trips and enable" if self._gate.causes else "enable"
        return self._answered(response, self._gate.unload(), f"unloading; after at most a few seconds {then} to go on")

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answered(response, self._gate.reset(), "reset; enable to go on")

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if not request.data:
            self._gate.disable()
            return self._answered(response, None, "disabled")
        return self._answered(response, self._refusal() or self._gate.enable(), "enabled")

    def _answered(self, response: Any, refusal: str | None, message: str) -> Any:
        """Fill in a service's response, and publish diagnostics at once."""
        response.success, response.message = refusal is None, refusal or message
        self._node.get_logger().info(f"safety gate: {response.message}")
        self._node.report()
        return response
