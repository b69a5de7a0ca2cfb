"""The node around any controller: it answers each loader_state with a valve_command.

`fasmc_node`, `sic_node` and `pid_node` are this node with the law they are named after.
"""

import os
import time
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from std_msgs.msg import Bool

from ehls_msgs.msg import ControllerStatus, FrictionEstimate, LoaderState, ValveCommand
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import SATURATED, model_of
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.serving import check_serves
from ehls_ros.errors import BadInput
from ehls_ros.nodes.control import OK, WARN, ControlNode
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.parameters import declare, follow, values_of
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, control_qos, message_class
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import SENSED
from ehls_ros.recording.topics import DRIVING, REFERENCE_TOPICS
from ehls_ros.schema import quantity

PATIENCE = 1.0
"""How long a cycle may lack something before diagnostics say so [s]."""

TURN = 0.005
"""Longest wait for one message before the others are looked at [s]."""

KEPT = 4000
"""References and estimates kept ahead of their cycle."""

LOCKSTEP_PATIENCE = 10.0
"""What friction_patience is in lockstep [s]: nothing is late there, and a run stays the same whatever else the machine does."""


class Parameters(NamedTuple):
    """What every controller node has besides its law's parameters."""

    friction_patience: Annotated[
        float,
        quantity("s", "in realtime, longest wait for a friction estimate while they arrive", minimum=0.0, maximum=60.0),
    ] = 0.005


class ControllerNode(ControlNode):
    """Runs one control law.

    While friction estimates arrive, a cycle is answered as soon as its estimate is there. Without them the rig's friction of
    steady sliding is used instead, and status and diagnostics say so.
    """

    def __init__(self, law: str) -> None:
        """Declare the law's parameters, with the spec's values where it names this law.

        Raises:
            BadInput: the spec's reference is none for this law.
        """
        super().__init__(f"{law}_node")
        declare(self, Parameters, live=False)
        self.friction_patience = LOCKSTEP_PATIENCE if self.lockstep else float(self.get_parameter("friction_patience").value)
        self.law = law
        self.kind = CONTROLLERS.load(law)
        check_serves(CONTROLLERS, law, self.spec.controller_rig, self.get_name())
        given = self.spec.controller
        meant_for = CONTROLLERS.load(given.name).FOLLOWS
        if meant_for != self.kind.FOLLOWS:
            what = f"the spec's reference is a {meant_for} for {given.name}"
            raise BadInput(what, self.get_name(), f"a spec whose controller follows a {self.kind.FOLLOWS}, as {law} does")
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
        self.period = period
        self.controller = Controller(self.law, self.tuning, model_of(self.spec.controller_rig, period))
        self.static_friction = FrictionEstimator("stribeck", self.spec.controller_rig, period)
        self.pending: dict[int, tuple[Any, ...]] = {}
        self.pending_since = 0.0
        self.references: dict[int, tuple[float, float, float]] = {}
        self.frictions: dict[int, tuple[float, float]] = {}
        self.friction_comes = self.kind.FRICTION
        self.newest_friction = -1
        self.answered = -1
        self.fallbacks = 0
        self.saturated = False
        self.latency = Latency()
        self.states = Inbox(self, LoaderState, "loader_state")
        topic = REFERENCE_TOPICS[self.kind.FOLLOWS]
        self.reference = Inbox(self, message_class(topic.type), topic.name)
        # By the frame the plant tells this controller's commands from another's.
        self.commands = Outbox(self, ValveCommand, "valve_command", frame_id=f"{self.get_fully_qualified_name()}-{os.getpid()}")
        self.status = Outbox(self, ControllerStatus, "controller_status")
        self.friction = Inbox(self, FrictionEstimate, "friction_estimate")
        self.driving = Inbox(self, Bool, DRIVING.name, control_qos(1), _is_true)
        self.driven = True
        self.on_state = Waiter([self.states])
        self.on_friction = Waiter([self.friction])
        self.on_anything = Waiter([self.states, self.friction, self.reference])
        self.measured = np.zeros(7)
        self.wanted = np.zeros(3)
        self.estimate = np.zeros(2)

    def release(self) -> None:
        """Close the topics."""
        for part in (
            self.on_state,
            self.on_friction,
            self.on_anything,
            self.states,
            self.reference,
            self.friction,
            self.driving,
        ):
            part.destroy()
        self.commands.destroy()
        self.status.destroy()

    def once(self) -> None:
        """Wait for what the next cycle lacks; answer the newest cycle that has all it needs."""
        self._wait()
        arrived = time.perf_counter()
        while (message := self.friction.take()) is not None:
            self.newest_friction = message[1]
            self.frictions[self.newest_friction] = message[2:4]
            self.friction_comes = self.kind.FRICTION
        while (message := self.states.take()) is not None:
            if not self.pending:
                self.pending_since = arrived
            self.pending[message[1]] = message
        if self.pending and max(self.pending) not in self.references:
            while (message := self.reference.take()) is not None:
                self.references[message[1]] = message[2:5]
        for cycle in sorted(self.pending, reverse=True):
            if self._complete(cycle, arrived):
                self._answer(self.pending[cycle])
                self.latency.add(time.perf_counter() - arrived)
                # What is older would be answered too late.
                self.pending = {k: state for k, state in self.pending.items() if k > cycle}
                self.pending_since = arrived
                break

    def _wait(self) -> None:
        """Wait on the one message that comes last, so that a cycle wakes this process once.

        That is the friction estimate as a rule; yet it may overtake its snapshot on the way here.
        """
        if self.pending:
            self.on_anything.wait(TURN)
        elif self.friction_comes and self.newest_friction <= self.answered:
            self.on_friction.wait(TURN)
        else:
            self.on_state.wait(TURN)

    def _complete(self, cycle: int, now: float) -> bool:
        """Tell whether a cycle can be answered, if necessary without a friction estimate."""
        if cycle not in self.references:
            return False
        if cycle in self.frictions or not self.friction_comes:
            return True
        if now - self.pending_since > self.friction_patience:
            self.friction_comes = False
        return not self.friction_comes

    def _answer(self, state: tuple[Any, ...]) -> None:
        stamp, cycle = state[:2]
        reference, friction = self.references[cycle], self.frictions.get(cycle)
        while (driven := self.driving.take()) is not None:
            self.driven = driven
        if not self.driven:
            # What the valve does not follow is nothing to learn from.
            self.controller.reset()
        elapsed = cycle - self.answered if self.answered >= 0 else 1
        if elapsed < 1:
            self.controller.reset()
            elapsed = 1
        if self.new_tuning is not None:
            self.controller.retune(self.new_tuning)
            self.new_tuning = None
            self.tuned_at = cycle
        fallback = friction is None and self.kind.FRICTION
        self.measured[:] = state[2:]
        self.wanted[:] = reference
        if friction is not None:
            self.estimate[:] = friction
        elif fallback:
            self.estimate[:] = self.static_friction.update(state[2 + sensors.VELOCITY], elapsed)[:2]
            self.fallbacks += 1
        command = self.controller.step(self.measured, self.wanted, self.estimate, elapsed)
        self.commands.send(stamp, cycle, command)
        values = self.controller.status.tolist()
        self.saturated = values[SATURATED] != 0.0
        self.status.send(stamp, cycle, *values[:SATURATED], self.saturated, fallback)
        self.answered = cycle
        self._forget(cycle)

    def _forget(self, cycle: int) -> None:
        """Drop what earlier cycles left, now and then."""
        self.references.pop(cycle, None)
        self.frictions.pop(cycle, None)
        if len(self.references) > KEPT:
            self.references = {k: v for k, v in self.references.items() if k > cycle}
        if len(self.frictions) > KEPT:
            self.frictions = {k: v for k, v in self.frictions.items() if k > cycle}

    def _without(self, unmeasured: list[str]) -> str:
        """Say which laws control the same without some readings."""
        laws = {name: CONTROLLERS.load(name) for name in CONTROLLERS.names()}
        able = [name for name, law in laws.items() if law.FOLLOWS == self.kind.FOLLOWS and not set(law.NEEDS) & set(unmeasured)]
        return f"without: {', '.join(able)}" if able else "no law does without"

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Say how answering goes."""
        figures = {
            "cycle": self.answered,
            "friction_fallbacks": self.fallbacks,
            "tuned_at_cycle": self.tuned_at,
            "saturated": self.saturated,
            **self.latency.figures(),
        }
        unmeasured = [name for name in self.kind.NEEDS if np.isnan(self.measured[SENSED.index(name)])]
        if unmeasured:
            return WARN, f"not measured, yet needed: {', '.join(unmeasured)}; {self._without(unmeasured)}", figures
        if self.kind.FRICTION and not self.friction_comes:
            return WARN, "no friction estimate comes: the rig's friction of steady sliding is used instead", figures
        if self.pending and time.perf_counter() - self.pending_since > PATIENCE:
            return WARN, f"no {self.kind.FOLLOWS} reference for the cycle under way", figures
        return OK, "running" if self._active.is_set() else "inactive", figures


def _is_true(message: bytes) -> bool:
    """Return what a Bool says."""
    return message[4:5] == b"\1"
