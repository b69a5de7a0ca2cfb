"""The control path on DDS: raw publishers and subscriptions, taken from in a loop of our own.

An executor's callback per message costs more than the control law. Here the node's main thread waits on
its subscriptions itself, takes what is there and answers; lifecycle, parameters and timers stay with an
executor in a second thread (:mod:`ehls_ros.nodes.control`). rclpy offers no public way to wait on
subscriptions without an executor; all use of its inner interface is in this file.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.type_support import check_for_type_support

from ehls_ros.nodes.codec import Decoder, Encoder

DEPTH = 1000
"""Messages kept for a reader that is late: one second of cycles."""

RECORDER_DEPTH = 50_000
"""Messages kept for the recorder, which takes them in bulk."""


def control_qos(depth: int = DEPTH) -> QoSProfile:
    """Return the quality of service of every control-path topic.

    Reliable and transient local: a node that is discovered late, or started anew, is given what it missed,
    so that the order in which nodes come up loses nothing.
    """
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def newest_qos() -> QoSProfile:
    """Return the quality of service of a reader that only wants to know where the cycles have got to."""
    return QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


def message_class(name: str) -> Any:
    """Return the class of a type named like ``std_msgs/msg/Float64``."""
    package, folder, kind = name.split("/")
    return getattr(import_module(f"{package}.{folder}"), kind)


class Outbox:
    """Publishes one control-path topic."""

    def __init__(
        self, node: Node, message: Any, topic: str, frame_id: str = "", lengths: Mapping[str, int] | None = None
    ) -> None:
        """Create the publisher.

        Args:
            node: owner.
            message: message class.
            topic: name below the node's namespace.
            frame_id: the header's frame.
            lengths: length of each sequence field.
        """
        self._node = node
        self._publisher = node.create_publisher(message, topic, control_qos())
        self._encode = Encoder(message, frame_id, lengths)

    def send(self, stamp_ns: int, *values: float) -> None:
        """Publish one message: header stamp [ns], then the fields in order."""
        self._publisher.handle.publish_raw(self._encode(stamp_ns, *values))

    def destroy(self) -> None:
        """Take the publisher off the graph."""
        self._node.destroy_publisher(self._publisher)


class Inbox:
    """Takes one topic's messages, in the thread that asks."""

    def __init__(
        self, node: Node, message: Any, topic: str, qos: QoSProfile | None = None, decode: Callable[[bytes], Any] | None = None
    ) -> None:
        """Create a subscription no executor knows of.

        Args:
            node: owner.
            message: message class.
            topic: name below the node's namespace, or absolute.
            qos: quality of service; that of the control path by default.
            decode: what is made of the bytes; the leading numbers as a tuple by default.
        """
        check_for_type_support(message)
        profile = (qos or control_qos()).get_c_qos_profile()
        with node.handle:
            self.handle = rclpy_implementation.Subscription(node.handle, message, topic, profile)
        self._message = message
        self._decode = decode or Decoder(message)
        self.malformed = 0

    def take(self) -> Any:
        """Return the next message decoded, or None when there is none; what cannot be decoded is counted."""
        while True:
            taken = self.handle.take_message(self._message, True)
            if taken is None:
                return None
            decoded = self._decode(taken[0])
            if decoded is not None:
                return decoded
            self.malformed += 1

    def take_raw(self) -> tuple[bytes, Mapping[str, int]] | None:
        """Return the next message's bytes and time stamps as they came, or None when there is none."""
        taken: tuple[bytes, Mapping[str, int]] | None = self.handle.take_message(self._message, True)
        return taken

    def destroy(self) -> None:
        """Take the subscription off the graph."""
        self.handle.destroy_when_not_in_use()


class Waiter:
    """Waits until one of some inboxes holds a message."""

    def __init__(self, inboxes: Sequence[Inbox]) -> None:
        """Make a wait set for these inboxes."""
        context = rclpy.get_default_context().handle
        self._inboxes = inboxes
        self._set = rclpy_implementation.WaitSet(len(inboxes), 0, 0, 0, 0, 0, context)

    def wait(self, seconds: float) -> None:
        """Wait until a message is there or the time is up."""
        self._set.clear_entities()
        for inbox in self._inboxes:
            self._set.add_subscription(inbox.handle)
        self._set.wait(max(0, int(seconds * 1e9)))

    def destroy(self) -> None:
        """Give the wait set back."""
        self._set.destroy_when_not_in_use()
