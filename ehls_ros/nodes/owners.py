"""The owners of a node's inputs over DDS: refusals, departures, and the node's reaction to a refusal of its messages.

:mod:`ehls_ros.hardware.ownership` has the rule for one input. A reader that refuses a sender publishes that on the topic
``refused``, and the refused node deactivates itself. Two senders that began together may each be refused by a reader that
received the other one first; then the sender whose name comes first in the alphabet stays.
"""

import os
import time
from typing import Any, Protocol

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.timer import Timer
from std_msgs.msg import String

from ehls_msgs.msg import Refusal
from ehls_ros.hardware.ownership import MOST_CONTENDERS, Ownership, node_of, process_of
from ehls_ros.process import is_running
from ehls_ros.recording.topics import LEAVING, REFUSED

DISCOVERY_RANGE, LOCALHOST = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"
"""Environment variable that limits how far the middleware discovers other nodes, and its value for this host only."""

REPEAT = 1.0
"""Time after which a refusal is published again while its sender continues [s]."""

GLANCE = 0.05
"""Interval between checks whether the owner of a contended input has ended [s]."""

DECISION = 0.1
"""Time between a node's first refusal and its reaction, in which the refusal of the other sender would arrive [s]."""


class Refusable(Protocol):
    """A node that can be refused.

    Attributes:
        sender: name of this node and process in messages.
    """

    sender: str

    def be_refused(self, topic: str, owner: str) -> None:
        """Stop sending: another sender owns an input."""


class Owners:
    """The inputs of one node."""

    def __init__(self, node: Any) -> None:
        """Subscribe to announcements; ``node`` is an rclpy node that is :class:`Refusable`."""
        self._node: Any = node
        self._inputs: dict[str, Ownership] = {}
        self._published: dict[tuple[str, str], float] = {}
        self._looked: dict[str, float] = {}
        self._refused: dict[str, str] = {}
        self._owner_refused_for_us: set[tuple[str, str]] = set()
        self._deciding: Timer | None = None
        # A refusal may arrive before its sender is matched.
        kept = QoSProfile(depth=REFUSED.depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._refusals = node.create_publisher(Refusal, REFUSED.name, kept)
        node.create_subscription(Refusal, REFUSED.name, self._on_refusal, kept)
        # A sender may leave before it is matched: its kept messages arrive after that, so its kept announcement must, too.
        # The other subscription is for publishers that keep none, whose profile is no mistake then.
        stored = QoSProfile(depth=LEAVING.depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        node.create_subscription(String, LEAVING.name, self._on_leaving, stored, event_callbacks=silent)
        node.create_subscription(String, LEAVING.name, self._on_leaving, QoSProfile(depth=LEAVING.depth))

    def of(self, topic: str) -> "Owner":
        """Return the owner of an input, which all readers of the node share."""
        return Owner(self, topic, self._inputs.setdefault(topic, Ownership()))

    def owner_of(self, topic: str) -> str | None:
        """Return the owner of an input; None if it is free, or no input of this node."""
        ownership = self._inputs.get(topic)
        return None if ownership is None else ownership.owner

    def refuse(self, topic: str, sender: str) -> None:
        """Publish that a sender is refused, once it is certain that the owner continues."""
        ownership, now = self._inputs[topic], time.monotonic()
        owner = ownership.owner
        if owner is None or not ownership.must_yield(sender) or now - self._published.get((topic, sender), -REPEAT) < REPEAT:
            return
        if len(self._published) > MOST_CONTENDERS * len(self._inputs):
            self._published.clear()
        if (topic, sender) not in self._published:
            self._node.get_logger().warning(self._sentence(topic, sender, owner))
        self._published[topic, sender] = now
        refusal = Refusal(input=topic, sender=sender, owner=owner)
        refusal.header.stamp = self._node.get_clock().now().to_msg()
        self._refusals.publish(refusal)

    def frees(self, topic: str) -> bool:
        """Free an input whose owner's process has ended; return whether it did. Called on a contender's messages."""
        ownership, now = self._inputs[topic], time.monotonic()
        if now - self._looked.get(topic, -GLANCE) < GLANCE:
            return False
        self._looked[topic] = now
        owner = ownership.owner
        if owner is None or self.may_run(owner):
            return False
        self._node.get_logger().info(f"{_name(owner)} has ended: {topic} is free")
        ownership.release(owner, time.time_ns())
        return True

    def look(self) -> None:
        """Free the inputs whose owner has fallen silent and left the graph; called at intervals.

        A contender that waits for an answer, such as a plant in lockstep, sends no further message that could be refused.
        """
        for topic, ownership in self._inputs.items():
            for sender in ownership.contenders.copy():
                if (topic, sender) not in self._published:
                    self.refuse(topic, sender)
            owner = ownership.owner
            if owner is not None and ownership.silent and not self._is_present(topic, owner, ownership):
                self._node.get_logger().info(f"{_name(owner)} has left: {topic} is free")
                ownership.release(owner, time.time_ns())

    def _is_present(self, topic: str, owner: str, ownership: Ownership) -> bool:
        """Return whether the owner may still be there: its process runs, and the graph has its node among the publishers.

        A killed node stays in the graph until the middleware notices, which takes 20 s.
        """
        if not self.may_run(owner):
            return False
        endpoints = self._node.get_publishers_info_by_topic(topic)
        names = {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in endpoints}
        if node_of(owner).startswith("/"):
            return node_of(owner) in names
        # A sender not named after its node may be any publisher that is not a contender.
        return bool(names - {node_of(sender) for sender in ownership.contenders})

    @staticmethod
    def may_run(sender: str) -> bool:
        """Return whether a sender's process may be running; one on another host may."""
        process = process_of(sender)
        return process is None or os.environ.get(DISCOVERY_RANGE) != LOCALHOST or is_running(process)

    def complaint(self) -> str:
        """Return a sentence about a sender that is refused at present; empty if there is none."""
        for topic, ownership in self._inputs.items():
            if (sender := ownership.contender) is not None and ownership.owner is not None:
                return self._sentence(topic, sender, ownership.owner)
        return ""

    @staticmethod
    def _sentence(topic: str, sender: str, owner: str) -> str:
        return f"{topic} of {_name(sender)} is refused: {_name(owner)} owns it; deactivate or stop one of the two"

    def _on_leaving(self, message: String) -> None:
        # rclpy's events executor cannot pass on when it was sent; the sender waits for the announcement to be received.
        for ownership in self._inputs.values():
            ownership.release(message.data, time.time_ns())

    def _on_refusal(self, refusal: Refusal) -> None:
        if refusal.owner == self._node.sender:
            self._owner_refused_for_us.add((refusal.input, refusal.sender))
        if refusal.sender == self._node.sender:
            self._refused[refusal.input] = refusal.owner
            if self._deciding is None:
                self._deciding = self._node.create_timer(DECISION, self._decide, clock=self._node.steady)

    def _decide(self) -> None:
        if self._deciding is not None:
            self._node.destroy_timer(self._deciding)
            self._deciding = None
        mutual, self._owner_refused_for_us = self._owner_refused_for_us, set()
        refused, self._refused = self._refused, {}
        for topic, owner in refused.items():
            if (topic, owner) not in mutual or owner < self._node.sender:
                self._node.be_refused(topic, owner)
                return


class Owner:
    """The owner of one input, for its readers in the loop's thread."""

    def __init__(self, owners: Owners, topic: str, ownership: Ownership) -> None:
        """Share the ownership of a topic."""
        self._owners, self._topic, self._ownership = owners, topic, ownership

    def admits(self, sender: str, sent_ns: int | None = None) -> bool:
        """Return whether a sender's message is accepted; if the sender is refused, publish the refusal.

        Args:
            sender: name of the sender.
            sent_ns: time at which it sent the message [ns]; None: just now.
        """
        ownership = self._ownership
        if ownership.admits(sender, sent_ns) or (self._owners.frees(self._topic) and ownership.admits(sender, sent_ns)):
            return True
        self._owners.refuse(self._topic, sender)
        return False

    def may_take(self, sender: str) -> bool:
        """Return whether a refused sender could be accepted by now: it is the owner, or there is none."""
        return self._ownership.owner in {None, sender}

    def holds(self, sender: str, sent_ns: int) -> bool:
        """Return whether a refused message is still valid: its sender has not left since it was sent [ns]."""
        return not self._ownership.has_left_since(sender, sent_ns) and self._owners.may_run(sender)


def _name(sender: str) -> str:
    return sender or "a node that does not name itself"


def owners_of(node: Node) -> Owners | None:
    """Return the owners of a node's inputs; None for a node that accepts all senders."""
    found: Owners | None = getattr(node, "owners", None)
    return found
