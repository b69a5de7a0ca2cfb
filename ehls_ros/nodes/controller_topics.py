"""The topics of a controller node."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from std_msgs.msg import Bool, String

from ehls_msgs.msg import ControllerStatus, Driver, FrictionEstimate, LoaderState, ValveCommand
from ehls_ros.control.cycles import KEPT
from ehls_ros.experiments.spec import Spec, signal_kind, uses_actuator
from ehls_ros.nodes.codec import decode_flag
from ehls_ros.nodes.control import PATIENCE, ControlNode
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, control_qos, message_class
from ehls_ros.recording.topics import (
    ACCEPTED_RIG,
    ACTUATOR_TOPICS,
    DRIVER,
    IN_FULL,
    PROGRAMME_POINT,
    REFERENCE_TOPICS,
    STANDBY_COMMAND,
    Topic,
)

TURN = 0.005
"""Longest wait for one topic before the others are read [s]."""

STATUS_BATCH = 5
"""Status messages that are published in one batch, as no cycle waits for them."""


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


class ControllerTopics:
    """The open topics of a controller node.

    Attributes:
        states: snapshots.
        reference: of the quantity that the law follows.
        friction: friction estimates.
        driver: announcements of the driver.
        in_full: whether commands reach the valve unchanged.
        other_commands: valve commands of all controllers.
        actuator: command of the actuator under test, ahead of the cycles; None if no companion uses it.
        points: points of the programme, ahead of the cycles; None without a programme or companions.
        commands: commands to the valve.
        standby_commands: commands of a controller that stands by.
        status: status of the law.
        arrivals: waiters by the input that a cycle lacks.
        command_arrival: waiter for a command of another controller.
    """

    def __init__(
        self, node: ControlNode, spec: Spec, follows: str, *, companions: bool, on_accepted: Callable[[String], None] | None
    ) -> None:
        """Open the topics.

        Args:
            node: owner.
            spec: the experiment.
            follows: quantity that the law follows: ``force`` or ``position``.
            companions: whether the law has companions.
            on_accepted: called with each rig that an operator has accepted; None: these are not received.
        """
        self._node = node
        self.states = Inbox(node, LoaderState, "loader_state")
        reference = REFERENCE_TOPICS[follows]
        self.reference = Inbox(node, message_class(reference.type), reference.name)
        self.commands = Outbox(node, ValveCommand, "valve_command", answers=True)
        self.status = Outbox(node, ControllerStatus, "controller_status", batch=STATUS_BATCH)
        self.standby_commands = Outbox(node, ValveCommand, STANDBY_COMMAND.name)
        self._accepted: Any = None
        if on_accepted is not None:
            self._accepted = node.create_subscription(String, ACCEPTED_RIG.name, on_accepted, control_qos(ACCEPTED_RIG.depth))
        self.driver = Inbox(node, Driver, DRIVER.name, owned="loader_state")
        self.in_full = Inbox(node, Bool, IN_FULL.name, control_qos(IN_FULL.depth), decode_flag)
        self.other_commands = Inbox(node, ValveCommand, "valve_command", owned="")
        self.friction = Inbox(node, FrictionEstimate, "friction_estimate")
        patience = PATIENCE if node.lockstep else 0.0
        actuator = ACTUATOR_TOPICS[signal_kind(spec.disturbance.name)]
        self.actuator = RowsAhead(node, actuator, patience) if uses_actuator(spec) else None
        has_points = companions and spec.reference.name == "programme"
        self.points = RowsAhead(node, PROGRAMME_POINT, patience) if has_points else None
        self.arrivals = {
            "snapshot": Waiter([self.states, self.driver]),
            "friction": Waiter([self.friction, self.driver]),
            "reference": Waiter([self.states, self.friction, self.reference]),
            # Unread references of later cycles would end a wait for the estimate at once, again and again.
            "estimate": Waiter([self.states, self.friction]),
        }
        self.command_arrival = Waiter([self.other_commands])

    def plant_reads_commands(self) -> bool:
        """Return whether the node that announces the driver reads the valve commands itself."""
        plants, readers = (
            {(info.node_namespace, info.node_name) for info in endpoints}
            for endpoints in (
                self._node.get_publishers_info_by_topic(DRIVER.name),
                self._node.get_subscriptions_info_by_topic("valve_command"),
            )
        )
        return bool(plants & readers)

    def destroy(self) -> None:
        """Close the topics."""
        for waiter in (*self.arrivals.values(), self.command_arrival):
            waiter.destroy()
        for inbox in (self.states, self.reference, self.friction, self.driver, self.in_full, self.other_commands):
            inbox.destroy()
        for ahead in filter(None, (self.actuator, self.points)):
            ahead.destroy()
        for outbox in (self.commands, self.status, self.standby_commands):
            outbox.destroy()
        if self._accepted is not None:
            self._node.destroy_subscription(self._accepted)
