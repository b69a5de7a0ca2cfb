"""The node of any controller: it answers each loader_state with a valve_command.

:mod:`ehls_ros.control.cycles` matches what belongs to a cycle; this file has the topics, parameters and diagnostics.
"""

import os
import time
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from std_msgs.msg import Bool

from ehls_msgs.msg import ControllerStatus, FrictionEstimate, LoaderState, ValveCommand
from ehls_ros.arrays import Array
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORESEEN, SATURATED, STATUS_TO_SI, model_of
from ehls_ros.control.cycles import KEPT, Cycles, Ready
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.experiments.loop import sampled
from ehls_ros.experiments.spec import check_law, company_of, signal_kind, uses_actuator
from ehls_ros.nodes.control import OK, PATIENCE, WARN, ControlNode
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.parameters import declare, follow, values_of
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, control_qos, message_class
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import SENSED
from ehls_ros.recording.topics import ACTUATOR_REFERENCE, DRIVING, REFERENCE_TOPICS
from ehls_ros.schema import quantity

TURN = 0.005
"""Longest wait for one topic before the others are read [s]."""

LOCKSTEP_PATIENCE = 10.0
"""friction_patience in lockstep [s]: nothing is late there, and a run must not depend on what else the machine does."""


class Parameters(NamedTuple):
    """What every controller node has in addition to the parameters of its law."""

    friction_patience: Annotated[
        float,
        quantity("s", "in realtime, longest time a cycle waits for its friction estimate", minimum=0.0, maximum=60.0),
    ] = 0.005


class ControllerNode(ControlNode):
    """Runs one control law.

    A cycle is answered once its friction estimate has come. If the estimate stays away, the rig's friction of steady
    sliding takes its place, and status and diagnostics say so.
    """

    def __init__(self, law: str) -> None:
        """Declare the law's parameters, with the spec's values if the spec is for this law.

        Raises:
            BadInput: the spec's reference is not what this law follows.
        """
        super().__init__(f"{law}_node")
        declare(self, Parameters, live=False)
        self.friction_patience = LOCKSTEP_PATIENCE if self.lockstep else float(self.get_parameter("friction_patience").value)
        self.law = law
        self.kind = CONTROLLERS.load(law)
        check_law(self.spec, law, self.get_name())
        given = self.spec.controller
        values = given.parameters._asdict() if given.name == law else {}
        declare(self, self.kind.Parameters, values, live=True)
        self.tuning = values_of(self, self.kind.Parameters, self.get_name())
        self.new_tuning: Any = None
        self.tuned_at = -1
        follow(self, self.kind.Parameters, self._retune)

    def _retune(self, tuning: Any) -> None:
        self.new_tuning = tuning

    def prepare(self) -> None:
        """Compile the law and open the topics."""
        period = self.spec.settings.control_period
        model = model_of(self.spec.controller_rig, period)
        self.company = company_of(self.spec, model, self.get_name(), self.law, self.tuning)
        self.controller = Controller(self.law, self.tuning, model, self.company)
        self.signal = sampled(self.spec.reference, period)
        self.static_friction = FrictionEstimator("stribeck", self.spec.controller_rig, period)
        self.cycles = Cycles(friction=self.kind.FRICTION, patience=self.friction_patience)
        self.fallbacks = 0
        self.saturated = False
        self.latency = Latency()
        self.states = Inbox(self, LoaderState, "loader_state")
        topic = REFERENCE_TOPICS[self.kind.FOLLOWS]
        self.reference = Inbox(self, message_class(topic.type), topic.name)
        # The process number tells two nodes of one name apart.
        sender = f"{self.get_fully_qualified_name()}-{os.getpid()}"
        self.commands = Outbox(self, ValveCommand, "valve_command", sender=sender)
        self.status = Outbox(self, ControllerStatus, "controller_status", sender=sender)
        self.friction = Inbox(self, FrictionEstimate, "friction_estimate")
        self.driving = Inbox(self, Bool, DRIVING.name, control_qos(1), _is_true)
        actuator = ACTUATOR_REFERENCE[signal_kind(self.spec.disturbance.name)]
        self.actuator = Inbox(self, message_class(actuator.type), actuator.name) if uses_actuator(self.spec) else None
        self.actuator_rows: dict[int, Sequence[float]] = {}
        self.driven = True
        self.answered: tuple[float, ...] = ()
        self.command = 0.0
        self.arrivals = {
            "snapshot": Waiter([self.states]),
            "friction": Waiter([self.friction]),
            "reference": Waiter([self.states, self.friction, self.reference]),
            # Unread references of later cycles would end a wait for the estimate at once, again and again.
            "estimate": Waiter([self.states, self.friction]),
        }
        self.measured = np.zeros(7)
        self.wanted = np.zeros(FORESEEN)
        self.estimate = np.zeros(2)

    def release(self) -> None:
        """Close the topics."""
        for waiter in self.arrivals.values():
            waiter.destroy()
        for inbox in filter(None, (self.states, self.reference, self.friction, self.driving, self.actuator)):
            inbox.destroy()
        self.company.save()
        for outbox in (self.commands, self.status):
            outbox.destroy()

    def once(self) -> None:
        """Wait for what the next cycle lacks; answer the newest cycle that has all it needs."""
        self.arrivals[self.cycles.lacks].wait(TURN)
        arrived = time.perf_counter()
        while (message := self.friction.take()) is not None:
            self.cycles.add_friction(message[1], message[2:4])
        while (message := self.states.take()) is not None:
            if message == self.answered:
                # In lockstep the plant asks again for an answer that has not reached it.
                self.commands.send(*message[:2], self.command)
                continue
            self.cycles.add_snapshot(message[1], message[0], message[2:], arrived)
        if self.cycles.lacks_reference:
            while (message := self.reference.take()) is not None:
                self.cycles.add_reference(message[1], message[2:5])
        if (ready := self.cycles.take(arrived)) is not None:
            self._answer(ready)
            self.latency.add(time.perf_counter() - arrived)

    def _answer(self, ready: Ready) -> None:
        while (driven := self.driving.take()) is not None:
            self.driven = driven
        if ready.anew or not self.driven:
            # The law must not adapt to cycles that the valve did not follow, or that belong to an earlier run.
            self.controller.reset()
        if self.new_tuning is not None:
            self.controller.retune(self.new_tuning)
            self.new_tuning = None
            self.tuned_at = ready.cycle
        self.measured[:] = ready.measured
        self.wanted[:] = ready.reference
        fallback = ready.friction is None and self.kind.FRICTION
        if ready.friction is not None:
            self.estimate[:] = ready.friction
        elif fallback:
            self.estimate[:] = self.static_friction.update(ready.measured[sensors.VELOCITY], ready.elapsed)[:2]
            self.fallbacks += 1
        place = self.signal.place(ready.cycle, 1)[0] if self.company else None
        actuator = self._actuator_row(ready.cycle)
        command = self.controller.step(self.measured, self.wanted, self.estimate, ready.elapsed, ready.cycle, place, actuator)
        self.commands.send(ready.stamp_ns, ready.cycle, command)
        self.answered, self.command = (ready.stamp_ns, ready.cycle, *ready.measured), command
        values = (self.controller.status * STATUS_TO_SI).tolist()
        self.saturated = values[SATURATED] != 0.0
        self.status.send(ready.stamp_ns, ready.cycle, *values[:SATURATED], self.saturated, fallback)

    def _actuator_row(self, cycle: int) -> Array | None:
        """Return the actuator's command at a cycle and its derivatives; None if nobody uses or tells it.

        It is sent before the reference of the same cycle, but another topic may overtake it: in lockstep it is waited for.
        """
        if self.actuator is None:
            return None
        until = time.perf_counter() + (PATIENCE if self.lockstep else 0.0)
        while True:
            while (message := self.actuator.take()) is not None:
                self.actuator_rows[message[1]] = message[2:5]
            if cycle in self.actuator_rows or time.perf_counter() >= until:
                break
        row = self.actuator_rows.pop(cycle, None)
        if len(self.actuator_rows) > KEPT:
            self.actuator_rows = {k: values for k, values in self.actuator_rows.items() if k > cycle}
        return None if row is None else np.array(row)

    def _without(self, unmeasured: list[str]) -> str:
        """Return which laws of the same kind need none of these readings."""
        laws = CONTROLLERS.usable()
        able = [name for name, law in laws.items() if law.FOLLOWS == self.kind.FOLLOWS and not set(law.NEEDS) & set(unmeasured)]
        return f"usable instead: {', '.join(able)}" if able else "no controller can do without"

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Say how answering goes."""
        figures = {
            "cycle": self.cycles.answered,
            "friction_fallbacks": self.fallbacks,
            "tuned_at_cycle": self.tuned_at,
            "saturated": self.saturated,
            **self.company.report(),
            **self.latency.figures(),
        }
        unmeasured = [name for name in self.kind.NEEDS if np.isnan(self.measured[SENSED.index(name)])]
        if unmeasured:
            return WARN, f"needed but not measured: {', '.join(unmeasured)}; {self._without(unmeasured)}", figures
        if self.kind.FRICTION and not self.cycles.friction_comes:
            return WARN, "no friction estimate arrives: the friction of steady sliding takes its place", figures
        if self.cycles.waited(time.perf_counter()) > PATIENCE:
            return WARN, f"no {self.kind.FOLLOWS} reference for the present cycle", figures
        return OK, "running" if self._active.is_set() else "inactive", figures


def _is_true(message: bytes) -> bool:
    """Return what a Bool says."""
    return message[4:5] == b"\1"
