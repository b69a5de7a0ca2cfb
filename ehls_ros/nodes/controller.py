"""Node of any controller: answers each loader_state with a valve_command.

While the plant obeys another controller, the node stands by: its law follows each cycle, including the command that the valve
received, and it publishes its would-be command on a separate topic.

:mod:`ehls_ros.control.cycles` matches the inputs of a cycle; this file has the topics, parameters and diagnostics.
"""

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from std_msgs.msg import String

from ehls_msgs.msg import ControllerStatus, Driver, FrictionEstimate, LoaderState, ValveCommand
from ehls_ros.control.adaptation.reach import sizes
from ehls_ros.control.controller import NOTHING_KNOWN, Controller, Outlook
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORESEEN, SATURATED, STATUS_TO_SI, Model, model_of
from ehls_ros.control.cycles import KEPT, Cycles, Ready
from ehls_ros.control.estimate_bounds import Bound, bounds_of, sentence
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.rig_scale import defaults_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments import learnt_files
from ehls_ros.experiments.accepted_rig import accepted_model
from ehls_ros.experiments.loop import sampled
from ehls_ros.experiments.spec import check_law, company_of, signal_kind, undeclared_effects, uses_actuator
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.nodes.control import OK, PATIENCE, WARN, ControlNode
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.parameters import declare, follow, values_of
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, control_qos, message_class
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import SENSED
from ehls_ros.recording.topics import (
    ACCEPTED_RIG,
    ACTUATOR_TOPICS,
    DRIVER,
    PROGRAMME_POINT,
    REFERENCE_TOPICS,
    STANDBY_COMMAND,
    Topic,
)
from ehls_ros.schema import quantity, text

TURN = 0.005
"""Longest wait for one topic before the others are read [s]."""

ROWS = 4
"""References taken in after each answer."""

STATUS_TOGETHER = 5
"""Status messages that are published together, as no cycle waits for them."""

LOCKSTEP_PATIENCE = 10.0
"""friction_patience in lockstep, and longest wait for another controller's command and for the driver message [s]: nothing
is late there, and a run must not depend on the load of the machine."""


NOTICE = 2.0
"""Time for which diagnostics keep showing an estimate that has left its bound [s]."""

HEARING = 0.5
"""Time after which a driver not heard on the topic of the node's commands counts as a relay [s]."""

HEARD = 100
"""Messages kept of the driver topic and of others' commands: many more cycles than a node may lag."""


TO_SI = STATUS_TO_SI.tolist()
"""Conversion factors of the status as Python floats: ten scalar products are faster than array operations."""


class Parameters(NamedTuple):
    """Parameters of every controller node besides those of its law."""

    friction_patience: Annotated[
        float,
        quantity("s", "in realtime, longest time a cycle waits for its friction estimate", minimum=0.0, maximum=60.0),
    ] = 0.005
    accept_rig: Annotated[bool, text("know the rig as the monitor tells it once an operator has accepted a change")] = False


class RowsAhead:
    """Rows of a topic that runs ahead of the cycles, for companions.

    Rows are sent before the reference of the same cycle, but another topic may overtake them: in lockstep the node waits.
    """

    def __init__(self, node: ControlNode, topic: Topic, patience: float) -> None:
        """Open the topic; ``patience`` is the longest wait for a row [s]."""
        self._inbox = Inbox(node, message_class(topic.type), topic.name)
        self._waiter = Waiter([self._inbox])
        self._patience = patience
        self._rows: dict[int, Sequence[float]] = {}

    def at(self, cycle: int) -> Sequence[float] | None:
        """Return the topic's row of a cycle; None if it has not arrived."""
        until = time.perf_counter() + self._patience
        while True:
            while (message := self._inbox.take()) is not None:
                self._rows[message[1]] = message[2:-1]
            if cycle in self._rows or time.perf_counter() >= until:
                break
            self._waiter.wait(TURN)
        if len(self._rows) > KEPT:
            self._rows = {k: row for k, row in self._rows.items() if k >= cycle}
        return self._rows.pop(cycle, None)

    def destroy(self) -> None:
        """Close the topic."""
        self._waiter.destroy()
        self._inbox.destroy()


class ControllerNode(ControlNode):
    """Runs one control law.

    A cycle is answered once its friction estimate has arrived. If it does not arrive, the rig's steady-sliding friction is
    used instead, and status and diagnostics report this.
    """

    longest_wait = TURN

    def __init__(self, law: str) -> None:
        """Declare the law's parameters, with the spec's values if the spec is for this law.

        Raises:
            BadInput: the spec's reference is not of the kind that this law follows.
        """
        super().__init__(f"{law}_node")
        declare(self, Parameters, live=False)
        self.friction_patience = LOCKSTEP_PATIENCE if self.lockstep else float(self.get_parameter("friction_patience").value)
        self.law = law
        self.kind = CONTROLLERS.load(law)
        check_law(self.spec, law, self.get_name())
        given = self.spec.controller
        declared = self.kind.Parameters
        same = given.name == law
        values = given.parameters._asdict() if same else defaults_for(declared, self.spec.controller_rig)
        declare(self, declared, values, live=True)
        self.tuning = values_of(self, declared, self.get_name())
        self.new_tuning: Any = None
        self.new_model: Model | None = None
        self.acceptance = ""
        self.tuned_at = -1
        self.bounds = bounds_of(self.kind, self.tuning)
        follow(self, declared, self._retune)

    def _retune(self, tuning: Any) -> None:
        self.new_tuning = tuning

    def _on_accepted(self, message: String) -> None:
        """Take in a rig that an operator has accepted; ignore an invalid one or one from several publishers."""
        publishers = self.get_publishers_info_by_topic(ACCEPTED_RIG.name)
        if len(publishers) > 1:
            names = ", ".join(sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in publishers))
            self._refuse_rig(f"{names} publish {ACCEPTED_RIG.name}; stop all but one, and accept again")
            return
        own, period = self.spec.controller_rig, self.spec.settings.control_period
        try:
            self.new_model = accepted_model(message.data, own, period, ACCEPTED_RIG.name)
        except BadInput as error:
            self._refuse_rig(str(error))

    def _refuse_rig(self, reason: str) -> None:
        self.acceptance = f"refused: {reason}"
        self.get_logger().error(f"the accepted rig is not used: {reason}")

    def _accept(self, model: Model, cycle: int) -> None:
        """Begin the transition to an accepted rig, or refuse it if it differs too much from the rig file's."""
        try:
            rig = self.spec.controller_rig
            duration = self.controller.accept(model, sizes(model_of(rig, model.period), rig.limits))
        except BadInput as error:
            self._refuse_rig(str(error))
        else:
            self.acceptance = f"in use from cycle {cycle} on"
            self.get_logger().info(f"the accepted rig is known from control cycle {cycle} on, all of it after {duration:.1f} s")

    def prepare(self) -> None:
        """Compile the law and open the topics."""
        period = self.spec.settings.control_period
        model = model_of(self.spec.controller_rig, period)
        for warning in undeclared_effects(self.spec, self.law):
            self.get_logger().warning(warning)
        self.company = company_of(self.spec, model, self.get_name(), self.law, self.tuning)
        learnt_files.recall(self.company, self.spec)
        self.controller = Controller(self.law, self.tuning, model, self.company)
        self.signal = sampled(self.spec.reference, period)
        self.static_friction = FrictionEstimator("stribeck", self.spec.controller_rig, period)
        self.cycles = Cycles(friction=self.kind.FRICTION, patience=self.friction_patience)
        self.fallback, self.fallbacks = False, 0
        self.saturated = False
        self.at_bound: dict[Bound, int] = {}
        self.latency = Latency()
        self.states = Inbox(self, LoaderState, "loader_state")
        topic = REFERENCE_TOPICS[self.kind.FOLLOWS]
        self.reference = Inbox(self, message_class(topic.type), topic.name)
        self.commands = Outbox(self, ValveCommand, "valve_command", answers=True)
        self.status = Outbox(self, ControllerStatus, "controller_status", together=STATUS_TOGETHER)
        self.shadow = Outbox(self, ValveCommand, STANDBY_COMMAND.name)
        accepts = bool(self.get_parameter("accept_rig").value)
        kept = control_qos(ACCEPTED_RIG.depth)
        self.accepted = self.create_subscription(String, ACCEPTED_RIG.name, self._on_accepted, kept) if accepts else None
        self.driver = Inbox(self, Driver, DRIVER.name, owned="loader_state")
        self.others = Inbox(self, ValveCommand, "valve_command", owned="")
        self.drivers: deque[tuple[int, str]] = deque(maxlen=HEARD)
        self.other_commands: deque[tuple[int, float, str]] = deque(maxlen=HEARD)
        self.heard: set[str] = set()
        self.relays: set[str] = set()
        self.named = 0.0
        self.first_reply_time = math.nan
        self.sent = True
        self.replied_at = 0.0
        self.friction = Inbox(self, FrictionEstimate, "friction_estimate")
        patience = PATIENCE if self.lockstep else 0.0
        actuator = ACTUATOR_TOPICS[signal_kind(self.spec.disturbance.name)]
        self.actuator = RowsAhead(self, actuator, patience) if uses_actuator(self.spec) else None
        has_programme = bool(self.company) and self.spec.reference.name == "programme"
        self.points = RowsAhead(self, PROGRAMME_POINT, patience) if has_programme else None
        self.driven = True
        self.answered: tuple[Any, ...] = ()
        self.command = 0.0
        self.arrivals = {
            "snapshot": Waiter([self.states, self.driver]),
            "friction": Waiter([self.friction, self.driver]),
            "reference": Waiter([self.states, self.friction, self.reference]),
            # Unread references of later cycles would end a wait for the estimate at once, again and again.
            "estimate": Waiter([self.states, self.friction]),
        }
        self.another = Waiter([self.others])
        self.measured = np.zeros(7)
        self.wanted = np.zeros(FORESEEN)
        self.estimate = np.zeros(2)

    def release(self) -> None:
        """Close the topics."""
        for waiter in (*self.arrivals.values(), self.another):
            waiter.destroy()
        for inbox in (self.states, self.reference, self.friction, self.driver, self.others):
            inbox.destroy()
        for ahead in filter(None, (self.actuator, self.points)):
            ahead.destroy()
        for outbox in (self.commands, self.status, self.shadow):
            outbox.destroy()
        if self.accepted is not None:
            self.destroy_subscription(self.accepted)
        try:
            learnt_files.keep(self.company, self.spec)
        except NotWritten as error:
            self.get_logger().error(str(error))
            self.failures.fail_at_end()

    def have_nothing_to_do(self) -> None:
        """Publish the status of the last cycles if no further cycle follows soon."""
        if time.perf_counter() - self.replied_at > TURN:
            self.status.flush()

    def stop(self) -> None:
        """Publish the status of the last cycles."""
        self.status.flush()

    def awaited_inputs(self) -> Waiter:
        """Return the waiter for the inputs that the next cycle lacks."""
        return self.arrivals[self.cycles.lacks]

    def react(self) -> bool:
        """Answer the newest cycle whose inputs are complete."""
        arrived = time.perf_counter()
        while (message := self.friction.take()) is not None:
            self.cycles.add_friction(message[1], message[2:4])
        while (message := self.states.take()) is not None:
            if message[:-1] == self.answered:
                # In lockstep the plant asks again for an answer that has not reached it.
                (self.commands if self.sent else self.shadow).send(*message[:2], self.command)
                continue
            self.cycles.add_snapshot(message[1], message[0], message[2:-1], arrived)
        if self.cycles.lacks_reference:
            self._take_references(math.inf)
        if not self._knows_who_drives():
            return False
        if not self.sent and self._driver_of(self.answered[1]) == self.sender:
            # The snapshot of the first cycle after a switch overtook the driver message.
            self._send()
        if (ready := self.cycles.take(arrived)) is None:
            return False
        self._answer(ready)
        self.replied_at = time.perf_counter()
        self.latency.add(self.replied_at - arrived)
        # Rows ahead arrive in bursts; reading a burst at once would delay the answer to the cycle that needs its first row.
        self._take_references(ROWS)
        return True

    def _take_references(self, most: float) -> None:
        """Read references of future cycles, at most a given number."""
        while most > 0 and (message := self.reference.take()) is not None:
            self.cycles.add_reference(message[1], message[2:5])
            most -= 1

    def _knows_who_drives(self) -> bool:
        """Note which sender drives from which cycle on; return False while that is not certain.

        A driver not heard on the topic of this node's commands, which the plant does not read, is no controller: it is a relay
        that passes the commands on to the plant.
        """
        while (message := self.driver.take()) is not None:
            _, first, self.driven, sender, _ = message
            if not self.drivers or self.drivers[-1] != (first, sender):
                self.drivers.append((first, sender))
                # The time of the first answer from then on is not yet known.
                self.named, self.first_reply_time = time.perf_counter(), math.nan
        if not self.drivers:
            return self.driver.publishers() == 0
        newest = self.drivers[-1][1]
        if newest == "" and self.lockstep and time.perf_counter() - self.first_reply_time < LOCKSTEP_PATIENCE:
            # Before the plant opens the next cycle, it announces whose answer came first.
            return False
        if newest in {"", self.sender}:
            return True
        self._listen()
        silent = newest not in self.heard and time.perf_counter() - self.named > HEARING
        if silent and not self._commands_reach_plant():
            self.relays.add(newest)
        return newest in self.heard | self.relays

    def _listen(self) -> None:
        """Read other controllers' commands; a sender that is heard is no relay."""
        while (message := self.others.take()) is not None:
            self.other_commands.append(message[1:4])
            self.heard.add(message[3])
            self.relays.discard(message[3])

    def _commands_reach_plant(self) -> bool:
        """Return whether the plant itself reads the topic of this node's commands; then another driver is no relay."""
        plants, readers = (
            {(info.node_namespace, info.node_name) for info in endpoints}
            for endpoints in (
                self.get_publishers_info_by_topic(DRIVER.name),
                self.get_subscriptions_info_by_topic("valve_command"),
            )
        )
        return bool(plants & readers)

    def _driver_of(self, cycle: int) -> str:
        """Return the sender whose answer to a cycle the plant accepts; empty: the first to answer."""
        driver = next((sender for first, sender in reversed(self.drivers) if cycle >= first), "")
        return "" if driver in self.relays else driver

    def _told(self, ready: Ready) -> float | None:
        """Return the spool command that another controller gave since the last answered cycle [m]; None if there is none."""
        last, driver = ready.cycle - 1, self._driver_of(ready.cycle - 1)
        if not self.answered or ready.anew or driver in {"", self.sender}:
            return None
        asked = time.perf_counter()
        while True:
            self._listen()
            told = [(cycle, spool) for cycle, spool, sender in self.other_commands if sender == driver]
            # In lockstep the plant receives the command of the last cycle before it opens the next.
            heard = any(cycle >= last for cycle, _ in told) or time.perf_counter() - asked > LOCKSTEP_PATIENCE
            if heard or not self.lockstep:
                since = [(cycle, spool) for cycle, spool in told if ready.cycle - ready.elapsed <= cycle <= last]
                return max(since)[1] if since else None
            self.another.wait(TURN)

    def _answer(self, ready: Ready) -> None:
        if ready.anew or not self.driven:
            # The law must not adapt to cycles that the valve did not follow, or that belong to an earlier run.
            self.controller.reset()
        if ready.anew:
            self.other_commands.clear()
        if self.new_tuning is not None:
            self.controller.retune(self.new_tuning)
            self.bounds = bounds_of(self.kind, self.new_tuning)
            self.new_tuning = None
            self.tuned_at = ready.cycle
        if self.new_model is not None:
            self._accept(self.new_model, ready.cycle)
            self.new_model = None
        self.measured[:] = ready.measured
        self.wanted[:] = ready.reference
        fallback = ready.friction is None and self.kind.FRICTION
        if ready.friction is not None:
            self.estimate[:] = ready.friction
        elif fallback:
            self.estimate[:] = self.static_friction.update(ready.measured[sensors.VELOCITY], ready.elapsed)[:2]
            self.fallbacks += 1
        seen = self.measured, self.wanted, self.estimate
        outlook = self._outlook(ready.cycle)
        if (told := self._told(ready)) is None:
            self.command = self.controller.step(*seen, ready.elapsed, outlook)
        else:
            self.command = self.controller.follow(*seen, told, ready.elapsed, outlook)
        self.answered, self.fallback = (ready.stamp_ns, ready.cycle, *ready.measured), fallback
        self._send(shadow=self._driver_of(ready.cycle) not in {"", self.sender})

    def _send(self, *, shadow: bool = False) -> None:
        """Send the command of the last answered cycle, to the valve or, on standby, to the shadow topic only."""
        stamp_ns, cycle = self.answered[:2]
        self.sent = not shadow
        if math.isnan(self.first_reply_time):
            self.first_reply_time = time.perf_counter()
        if not (shadow and self._unmeasured()):
            # A controller that lacks a reading must not be given the valve.
            (self.shadow if shadow else self.commands).send(stamp_ns, cycle, self.command)
        values = [value * factor for value, factor in zip(self.controller.status.tolist(), TO_SI, strict=True)]
        self.saturated = values[SATURATED] != 0.0
        reached = [bound for bound in self.bounds if bound.reached(values[bound.place])]
        self.at_bound.update(dict.fromkeys(reached, cycle))
        if not shadow:
            self.status.send(stamp_ns, cycle, *values[:SATURATED], self.saturated, bool(reached), self.fallback)

    def _unmeasured(self) -> list[str]:
        """Return the readings that the law needs and the last snapshot lacked."""
        return [name for name in self.kind.NEEDS if math.isnan(self.measured[SENSED.index(name)])]

    def _outlook(self, cycle: int) -> Outlook:
        """Return the inputs of the companions at a cycle."""
        if not self.company:
            return NOTHING_KNOWN
        actuator = None if self.actuator is None else self.actuator.at(cycle)
        if self.points is None:
            place = self.signal.place(cycle, 1)[0]
        elif (point := self.points.at(cycle)) is not None:
            place = np.array([point[0], point[1] + point[3]])
        else:
            place = None
        return Outlook(cycle, place, None if actuator is None else np.array(actuator[:FORESEEN]))

    def _without(self, unmeasured: list[str]) -> str:
        """Return the laws of the same kind that need none of these readings, as a sentence."""
        laws = CONTROLLERS.usable()
        able = [name for name, law in laws.items() if law.FOLLOWS == self.kind.FOLLOWS and not set(law.NEEDS) & set(unmeasured)]
        return f"usable instead: {', '.join(able)}" if able else "no controller can do without"

    def _at_bounds(self) -> list[str]:
        """Return a sentence for each estimate, of law and companions, that is or recently was at its bound."""
        recent = self.cycles.answered - NOTICE / self.spec.settings.control_period
        standing = [sentence(bound) for bound, cycle in list(self.at_bound.items()) if recent <= cycle <= self.cycles.answered]
        return [*standing, *self.company.at_bounds()]

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the state of the answering loop."""
        figures = {
            "cycle": self.cycles.answered,
            "friction_fallbacks": self.fallbacks,
            "tuned_at_cycle": self.tuned_at,
            "saturated": self.saturated,
            **({"accepted_rig": self.acceptance} if self.acceptance else {}),
            **self.company.report(),
            **self.latency.figures(),
        }
        if unmeasured := self._unmeasured():
            return WARN, f"needed but not measured: {', '.join(unmeasured)}; {self._without(unmeasured)}", figures
        if self.kind.FRICTION and not self.cycles.friction_comes:
            return WARN, "no friction estimate arrives: the friction of steady sliding takes its place", figures
        if self.cycles.waited(time.perf_counter()) > PATIENCE:
            return WARN, f"no {self.kind.FOLLOWS} reference for the present cycle", figures
        if self._active.is_set() and (standing := self._at_bounds()):
            return WARN, "; ".join(standing), figures
        if not self.sent and self._active.is_set():
            return OK, f"stands by: {self._driver_of(self.cycles.answered)} drives", figures
        return OK, "running" if self._active.is_set() else "inactive", figures
