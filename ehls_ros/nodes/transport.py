"""The control path on DDS: raw publishers and subscriptions, read by the node's own loop.

An executor callback per message costs more than the control law. So the node's main thread waits on its subscriptions
and takes the messages itself; lifecycle, parameters and timers are served by an executor in a second thread
(:mod:`ehls_ros.nodes.control`). rclpy has no public way to wait on subscriptions without an executor; all use of its
internals is in this file.
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
from ehls_ros.nodes.frames import loader_frame

DEPTH = 1000
"""Queue depth of a control-path topic: one second of cycles."""

RECORDER_DEPTH = 50_000
"""Queue depth of the recorder, which reads in bulk."""


def control_qos(depth: int = DEPTH) -> QoSProfile:
    """Return the quality of service of every control-path topic.

    Reliable and transient local: a node that starts late or restarts receives what it missed, so nodes may start in
    any order.
    """
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def newest_qos() -> QoSProfile:
    """Return the quality of service of a reader that needs only the newest cycle."""
    return QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


def message_class(name: str) -> Any:
    """Return the message class of a type name such as ``std_msgs/msg/Float64``."""
    package, folder, kind = name.split("/")
    return getattr(import_module(f"{package}.{folder}"), kind)


class Outbox:
    """Publishes one control-path topic."""

    def __init__(
        self, node: Node, message: Any, topic: str, lengths: Mapping[str, int] | None = None, sender: str = ""
    ) -> None:
        """Create the publisher.

        Args:
            node: owner.
            message: message class.
            topic: name below the node's namespace.
            lengths: length of each sequence field.
            sender: content of the text field, if there is one.
        """
        self._node = node
        self._publisher = node.create_publisher(message, topic, control_qos())
        self._encode = Encoder(message, loader_frame(node.get_namespace()), lengths, sender)

    def send(self, stamp_ns: int, *values: float) -> None:
        """Publish one message: header stamp [ns], then the fields in order."""
        self._publisher.handle.publish_raw(self._encode(stamp_ns, *values))

    def destroy(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)


class Inbox:
    """Receives one topic, in the thread that calls it."""

    def __init__(
        self, node: Node, message: Any, topic: str, qos: QoSProfile | None = None, decode: Callable[[bytes], Any] | None = None
    ) -> None:
        """Create a subscription without an executor.

        Args:
            node: owner.
            message: message class.
            topic: name below the node's namespace, or absolute.
            qos: quality of service; that of the control path by default.
            decode: converts the bytes; by default to a tuple of the leading numbers.
        """
        check_for_type_support(message)
        profile = (qos or control_qos()).get_c_qos_profile()
        with node.handle:
            self.handle = rclpy_implementation.Subscription(node.handle, message, topic, profile)
        self._message = message
        self._decode = decode or Decoder(message)
        self.malformed = 0

    def take(self) -> Any:
        """Return the next decoded message, or None; messages that cannot be decoded are skipped and counted."""
        while True:
            taken = self.handle.take_message(self._message, True)
            if taken is None:
                return None
            decoded = self._decode(taken[0])
            if decoded is not None:
                return decoded
            self.malformed += 1

    def take_raw(self) -> tuple[bytes, Mapping[str, int]] | None:
        """Return the next message's bytes and time stamps, or None."""
        taken: tuple[bytes, Mapping[str, int]] | None = self.handle.take_message(self._message, True)
        return taken

    def destroy(self) -> None:
        """Destroy the subscription."""
        self.handle.destroy_when_not_in_use()


class Waiter:
    """Waits until any of several inboxes has a message."""

    def __init__(self, inboxes: Sequence[Inbox]) -> None:
        """Create a wait set for the inboxes."""
        context = rclpy.get_default_context().handle
        self._inboxes = inboxes
        self._set = rclpy_implementation.WaitSet(len(inboxes), 0, 0, 0, 0, 0, context)

    def wait(self, seconds: float) -> None:
        """Wait for a message, at most for a time [s]."""
        self._set.clear_entities()
        for inbox in self._inboxes:
            self._set.add_subscription(inbox.handle)
        self._set.wait(max(0, int(seconds * 1e9)))

    def destroy(self) -> None:
        """Destroy the wait set."""
        self._set.destroy_when_not_in_use()
