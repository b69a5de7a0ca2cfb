"""Node of any controller: answers each loader_state with a valve_command.

While another controller drives, the node stands by: its law follows each cycle, including the command that the valve received,
and its command goes to a separate topic (:mod:`ehls_ros.hardware.handover`).

:mod:`ehls_ros.control.cycles` matches the inputs of a cycle; this file has the control cycle, parameters and diagnostics.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.controller import NOTHING_KNOWN, Controller, Outlook
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORESEEN, SATURATED, STATUS_TO_SI, model_of
from ehls_ros.control.cycles import Cycles, Ready
from ehls_ros.control.estimate_bounds import Bound, sentence
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.references.base import SampledReference
from ehls_ros.control.rig_scale import defaults_for
from ehls_ros.experiments import learnt_files
from ehls_ros.experiments.loop import sampled
from ehls_ros.experiments.spec import check_law, company_of, undeclared_effects
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.hardware.handover import ControllerHandover, ControllerState
from ehls_ros.nodes.adjustments import Adjustments
from ehls_ros.nodes.control import PATIENCE, ControlNode
from ehls_ros.nodes.controller_topics import TURN, ControllerTopics
from ehls_ros.nodes.diagnostics import OK, WARN
from ehls_ros.nodes.latency import Latency
from ehls_ros.nodes.parameters import declare, follow, values_of
from ehls_ros.nodes.transport import Waiter
from ehls_ros.physics import sensors
from ehls_ros.physics.rig import SENSED
from ehls_ros.schema import quantity, text

ROWS = 4
"""References read after each answer."""

LOCKSTEP_PATIENCE = 10.0
"""friction_patience in lockstep, and longest wait for another controller's command and for the driver message [s]: nothing
is late there, and a run must not depend on the load of the machine."""

NOTICE = 2.0
"""Time for which diagnostics keep showing an estimate that has left its bound [s]."""

TO_SI = STATUS_TO_SI.tolist()
"""Conversion factors of the status as Python floats: ten scalar products are faster than array operations."""


class Parameters(NamedTuple):
    """Parameters of every controller node besides those of its law."""

    friction_patience: Annotated[
        float,
        quantity("s", "in realtime, longest time a cycle waits for its friction estimate", minimum=0.0, maximum=60.0),
    ] = 0.005
    accept_rig: Annotated[bool, text("use the rig that the monitor publishes when an operator accepts a change")] = False


@dataclass(slots=True)
class LawInputs:
    """Inputs of the law in a cycle, as arrays that are reused.

    Attributes:
        measured: readings in the order of ``SENSED``, shape (7,).
        reference: value that the law follows, with first and second derivative, shape (3,).
        friction: force of the elements and viscous force [N], shape (2,).
    """

    measured: Array = field(default_factory=lambda: np.zeros(7))
    reference: Array = field(default_factory=lambda: np.zeros(FORESEEN))
    friction: Array = field(default_factory=lambda: np.zeros(2))


@dataclass(slots=True)
class LastAnswer:
    """The last answered cycle.

    Attributes:
        snapshot: stamp [ns], cycle and readings; empty before the first answer.
        command: spool command [m].
        to_valve: whether the command went to the valve, and not to the topic of the standby commands.
        fallback: whether the friction of steady sliding took the place of the estimate.
        time: of the answer, by :func:`time.perf_counter` [s].
    """

    snapshot: tuple[Any, ...] = ()
    command: float = 0.0
    to_valve: bool = True
    fallback: bool = False
    time: float = 0.0


@dataclass(slots=True)
class ControlStatistics:
    """Statistics of the answers.

    Attributes:
        latency: response times.
        fallbacks: answers without a friction estimate.
        saturated: whether the last command was saturated.
        at_bound: newest cycle in which an estimate was at its bound.
    """

    latency: Latency = field(default_factory=Latency)
    fallbacks: int = 0
    saturated: bool = False
    at_bound: dict[Bound, int] = field(default_factory=dict)


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
        self.adjustments = Adjustments(self, self.kind, values_of(self, declared, self.get_name()))
        follow(self, declared, self.adjustments.retune)
        # A plant without this message passes all commands on unchanged.
        self.in_full = True
        # Made by `prepare`:
        self.companions: CompanionChain
        self.controller: Controller
        self.signal: SampledReference
        self.static_friction: FrictionEstimator
        self.cycles: Cycles
        self.inputs: LawInputs
        self.answer: LastAnswer
        self.statistics: ControlStatistics
        self.handover: ControllerHandover
        self.topics: ControllerTopics

    def prepare(self) -> None:
        """Compile the law and open the topics."""
        period, tuning = self.spec.settings.control_period, self.adjustments.tuning
        model = model_of(self.spec.controller_rig, period)
        for warning in undeclared_effects(self.spec, self.law):
            self.get_logger().warning(warning)
        self.companions = company_of(self.spec, model, self.get_name(), self.law, tuning)
        learnt_files.recall(self.companions, self.spec)
        known = self.spec.controller_rig.cylinder.model, self.spec.controller_rig.valve.model
        self.controller = Controller(self.law, tuning, model, self.companions, *known)
        self.signal = sampled(self.spec.reference, period)
        self.static_friction = FrictionEstimator("stribeck", self.spec.controller_rig, period)
        self.cycles = Cycles(friction=self.kind.FRICTION, patience=self.friction_patience)
        self.inputs, self.answer, self.statistics = LawInputs(), LastAnswer(), ControlStatistics()
        self.handover = ControllerHandover(self.sender, LOCKSTEP_PATIENCE if self.lockstep else 0.0)
        accepts = bool(self.get_parameter("accept_rig").value)
        on_accepted = self.adjustments.accept if accepts else None
        companions = bool(self.companions)
        self.topics = ControllerTopics(self, self.spec, self.kind.FOLLOWS, companions=companions, on_accepted=on_accepted)

    def release(self) -> None:
        """Close the topics."""
        self.topics.destroy()
        try:
            learnt_files.keep(self.companions, self.spec)
        except NotWritten as error:
            self.get_logger().error(str(error))
            self.failures.fail_at_end()

    def idle(self) -> None:
        """Publish the status of the last cycles if no further cycle follows soon."""
        if time.perf_counter() - self.answer.time > TURN:
            self.topics.status.flush()

    def stop(self) -> None:
        """Publish the status of the last cycles."""
        self.topics.status.flush()

    def awaited_inputs(self) -> Waiter:
        """Return the waiter for the inputs that the next cycle lacks."""
        return self.topics.arrivals[self.cycles.lacks]

    def react(self) -> bool:
        """Answer the newest cycle whose inputs are complete."""
        arrived = time.perf_counter()
        self._take_inputs(arrived)
        if not self._may_answer():
            return False
        answer = self.answer
        if not answer.to_valve and self.handover.driver_of(answer.snapshot[1]) == self.sender:
            # The snapshot of the first cycle after a switch overtook the driver message.
            self._send(to_valve=True)
        if (ready := self.cycles.take(arrived)) is None:
            return False
        self._answer(ready)
        answer.time = time.perf_counter()
        self.statistics.latency.add(answer.time - arrived)
        # Rows ahead arrive in bursts; reading a burst at once would delay the answer to the cycle that needs its first row.
        self._take_references(ROWS)
        return True

    def _take_inputs(self, arrived: float) -> None:
        """Read friction estimates, snapshots and, if the newest cycle lacks its own, references."""
        topics, cycles, answer = self.topics, self.cycles, self.answer
        while (message := topics.friction.take()) is not None:
            cycles.add_friction(message[1], message[2:4])
        while (message := topics.states.take()) is not None:
            if message[:-1] == answer.snapshot:
                # In lockstep the plant repeats its request if the answer has not arrived.
                (topics.commands if answer.to_valve else topics.standby_commands).send(*message[:2], answer.command)
                continue
            cycles.add_snapshot(message[1], message[0], message[2:-1], arrived)
        if cycles.lacks_reference:
            self._take_references(math.inf)

    def _take_references(self, most: float) -> None:
        """Read references of future cycles, at most a given number."""
        while most > 0 and (message := self.topics.reference.take()) is not None:
            self.cycles.add_reference(message[1], message[2:5])
            most -= 1

    def _may_answer(self) -> bool:
        """Read the messages on the hand-over, and return whether the next cycle may be answered."""
        handover, topics = self.handover, self.topics
        while (message := topics.driver.take()) is not None:
            _, first, driving, sender, _ = message
            handover.announce(first, sender, driving=driving, now=time.perf_counter())
        while (flag := topics.in_full.take()) is not None:
            self.in_full = flag
        if handover.follows:
            self._take_other_commands()
        if handover.may_answer:
            return True
        if handover.state is ControllerState.UNANNOUNCED:
            # A plant without announcements obeys any controller.
            return topics.driver.publishers() == 0
        if handover.is_overdue(time.perf_counter()):
            handover.give_up(topics.plant_reads_commands)
        return handover.may_answer

    def _take_other_commands(self) -> None:
        """Read the commands of other controllers."""
        while (message := self.topics.other_commands.take()) is not None:
            self.handover.take_command(*message[1:4])

    def _command_of_driver(self, ready: Ready) -> float | None:
        """Return the spool command that another controller gave since the last answered cycle [m]; None if there is none."""
        handover, last = self.handover, ready.cycle - 1
        driver = handover.driver_of(last)
        if not driver or driver == self.sender or not self.answer.snapshot or ready.anew:
            return None
        since = time.perf_counter()
        while True:
            self._take_other_commands()
            # In lockstep the plant receives the command of the last cycle before it opens the next.
            if not self.lockstep or handover.has_command(driver, last) or time.perf_counter() - since > LOCKSTEP_PATIENCE:
                return handover.command_of(driver, ready.cycle - ready.elapsed, last)
            self.topics.command_arrival.wait(TURN)

    def _answer(self, ready: Ready) -> None:
        if ready.anew or not self.handover.valve_follows:
            # The law must not adapt to cycles that the valve did not follow, or that belong to an earlier run.
            self.controller.reset()
        if ready.anew:
            self.handover.forget_commands()
        self.adjustments.apply(self.controller, ready.cycle)
        fallback = self._fill_inputs(ready)
        outlook = self._outlook(ready.cycle)
        inputs, answer = self.inputs, self.answer
        given = self._command_of_driver(ready)
        if given is None:
            answer.command = self.controller.step(inputs.measured, inputs.reference, inputs.friction, ready.elapsed, outlook)
        else:
            answer.command = self.controller.follow(
                inputs.measured, inputs.reference, inputs.friction, given, ready.elapsed, outlook
            )
        if not self.in_full:
            # Adaptation would take the part of the command that the valve receives for the valve's gain.
            self.companions.interrupt()
        answer.snapshot, answer.fallback = (ready.stamp_ns, ready.cycle, *ready.measured), fallback
        driver = self.handover.driver_of(ready.cycle)
        self._send(to_valve=not driver or driver == self.sender)

    def _fill_inputs(self, ready: Ready) -> bool:
        """Fill in the inputs of the law; return whether the friction of steady sliding takes the place of the estimate."""
        inputs = self.inputs
        inputs.measured[:] = ready.measured
        inputs.reference[:] = ready.reference
        if ready.friction is not None:
            inputs.friction[:] = ready.friction
            return False
        if self.kind.FRICTION:
            inputs.friction[:] = self.static_friction.update(ready.measured[sensors.VELOCITY], ready.elapsed)[:2]
            self.statistics.fallbacks += 1
        return bool(self.kind.FRICTION)

    def _send(self, *, to_valve: bool) -> None:
        """Send the command of the last answered cycle, to the valve or, on standby, to the topic of the standby commands."""
        answer, topics, statistics = self.answer, self.topics, self.statistics
        stamp_ns, cycle = answer.snapshot[:2]
        answer.to_valve = to_valve
        if self.handover.state is ControllerState.VACANT:
            self.handover.answer(time.perf_counter())
        if to_valve:
            topics.commands.send(stamp_ns, cycle, answer.command)
        elif not self._unmeasured():
            # A controller that lacks a reading must not be given the valve.
            topics.standby_commands.send(stamp_ns, cycle, answer.command)
        values = [value * factor for value, factor in zip(self.controller.status.tolist(), TO_SI, strict=True)]
        statistics.saturated = values[SATURATED] != 0.0
        reached = [bound for bound in self.adjustments.bounds if bound.reached(values[bound.place])]
        statistics.at_bound.update(dict.fromkeys(reached, cycle))
        if to_valve:
            topics.status.send(stamp_ns, cycle, *values[:SATURATED], statistics.saturated, bool(reached), answer.fallback)

    def _unmeasured(self) -> list[str]:
        """Return the readings that the law needs and the last snapshot lacked."""
        return [name for name in self.kind.NEEDS if math.isnan(self.inputs.measured[SENSED.index(name)])]

    def _outlook(self, cycle: int) -> Outlook:
        """Return the inputs of the companions at a cycle."""
        if not self.companions:
            return NOTHING_KNOWN
        rows, points = self.topics.actuator, self.topics.points
        actuator = None if rows is None else rows.at(cycle)
        if points is None:
            place = self.signal.place(cycle, 1)[0]
        elif (point := points.at(cycle)) is not None:
            place = np.array([point[0], point[1] + point[3]])
        else:
            place = None
        return Outlook(cycle, place, None if actuator is None else np.array(actuator[:FORESEEN]))

    def _alternatives(self, unmeasured: Sequence[str]) -> str:
        """Return the laws of the same kind that need none of these readings, as a sentence."""
        laws = CONTROLLERS.usable()
        able = [name for name, law in laws.items() if law.FOLLOWS == self.kind.FOLLOWS and not set(law.NEEDS) & set(unmeasured)]
        return f"usable instead: {', '.join(able)}" if able else "no controller can do without"

    def _at_bounds(self) -> list[str]:
        """Return a sentence for each estimate, of law and companions, that is or recently was at its bound."""
        recent = self.cycles.answered - NOTICE / self.spec.settings.control_period
        reached = list(self.statistics.at_bound.items())
        standing = [sentence(bound) for bound, cycle in reached if recent <= cycle <= self.cycles.answered]
        return [*standing, *self.companions.at_bounds()]

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the state of the answering loop."""
        statistics, acceptance = self.statistics, self.adjustments.acceptance
        figures = {
            "cycle": self.cycles.answered,
            "friction_fallbacks": statistics.fallbacks,
            "tuned_at_cycle": self.adjustments.tuned_at,
            "saturated": statistics.saturated,
            **({"accepted_rig": acceptance} if acceptance else {}),
            **self.companions.report(),
            **statistics.latency.figures(),
        }
        if unmeasured := self._unmeasured():
            return WARN, f"needed but not measured: {', '.join(unmeasured)}; {self._alternatives(unmeasured)}", figures
        if self.kind.FRICTION and not self.cycles.friction_comes:
            return WARN, "no friction estimate arrives: the friction of steady sliding takes its place", figures
        if self.cycles.waited(time.perf_counter()) > PATIENCE:
            return WARN, f"no {self.kind.FOLLOWS} reference for the present cycle", figures
        if self.is_active and (standing := self._at_bounds()):
            return WARN, "; ".join(standing), figures
        if not self.answer.to_valve and self.is_active:
            return OK, f"stands by: {self.handover.driver_of(self.cycles.answered)} drives", figures
        return OK, self.activity, figures
