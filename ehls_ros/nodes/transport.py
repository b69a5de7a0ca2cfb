"""The control path on DDS: raw publishers and subscriptions, read by the node's main loop.

An executor callback per message costs more than the control law. So the node's main thread waits on its subscriptions
and takes the messages itself; lifecycle, parameters and timers are served by an executor in a second thread
(:mod:`ehls_ros.nodes.control`). rclpy has no public way to wait on subscriptions without an executor; all use of its
internals is in this file.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.type_support import check_for_type_support

from ehls_ros.nodes.codec import Decoder, Encoder
from ehls_ros.nodes.frames import loader_frame
from ehls_ros.nodes.links import Links, Message
from ehls_ros.nodes.owners import owners_of
from ehls_ros.recording.topics import DEPTH, SENDER

RECORDER_DEPTH = 50_000
"""Queue depth of the recorder, which reads in bulk."""

MOST_KEPT = 10_000
"""Maximum number of messages kept by a control-path topic."""


def kept_at(period: float) -> int:
    """Return the history depth of a control-path topic: one second of cycles, so that a busy machine may delay a reader.

    Args:
        period: control period [s].
    """
    return min(max(DEPTH, round(1.0 / period)), MOST_KEPT)


def control_qos(depth: int = DEPTH) -> QoSProfile:
    """Return the QoS profile that every control-path topic offers and its readers request.

    Reliable and transient local: a node that starts late or restarts receives the messages it missed, so nodes may start in
    any order. An :class:`Inbox` drops the request for transient local where a publisher does not offer it.
    """
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def newest_qos() -> QoSProfile:
    """Return the QoS profile of a reader that needs only the newest cycle."""
    return QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


def is_volatile(endpoint: TopicEndpointInfo) -> bool:
    """Return whether a publisher or reader is reliable but volatile: without messages sent before it was matched."""
    qos = endpoint.qos_profile
    return bool(qos.reliability == ReliabilityPolicy.RELIABLE and qos.durability == DurabilityPolicy.VOLATILE)


def message_class(name: str) -> Any:
    """Return the message class of a type name such as ``std_msgs/msg/Float64``."""
    package, folder, kind = name.split("/")
    return getattr(import_module(f"{package}.{folder}"), kind)


def links_of(node: Node) -> Links | None:
    """Return the links of a node to the others of its process; None if it is the only one."""
    return getattr(node, "links", None)


def _kept_by(node: Node) -> int:
    """Return the history depth of a node's control-path topics."""
    return int(getattr(node, "cycles_kept", DEPTH))


class Outbox:
    """Publishes one control-path topic; readers in the same process receive a message before it is published.

    Attributes:
        topic: its full name.
    """

    def __init__(
        self,
        node: Node,
        message: Any,
        topic: str,
        lengths: Mapping[str, int] | None = None,
        *,
        sender: str | None = None,
        opens: bool = False,
        answers: bool = False,
        batch: int = 1,
    ) -> None:
        """Create the publisher.

        Args:
            node: owner.
            message: message class.
            topic: name below the node's namespace.
            lengths: length of each sequence field.
            sender: named in the messages, if their type names one; None: the node's.
            opens: whether its messages are snapshots, each of which opens a cycle.
            answers: whether its messages answer them.
            batch: messages that are published in one batch, if no node waits for them: each single message wakes up a thread in
                every reader. :meth:`flush` publishes those that have gathered.
        """
        self._node = node
        self._opens, self._answers = opens, answers
        self._batch = batch
        self._gathered: list[bytes] = []
        sender = getattr(node, "sender", "") if sender is None else sender
        self._encode = Encoder(message, loader_frame(node.get_namespace()), lengths, sender)
        self._sender = (sender,) if SENDER in message.get_fields_and_field_types() else ()
        self._links = links_of(node)
        if self._links is not None:
            self._local = self._links.topic(topic)
            self._local.senders += 1
            self._local.named.update(self._sender)
        kept = _kept_by(node) if self._links is None else self._links.kept
        self._publisher = node.create_publisher(message, topic, control_qos(kept))
        self.topic: str = self._publisher.topic_name
        if self._links is not None:
            self._links.join(self)
        self._publish = self._publisher.handle.publish_raw

    def send(self, stamp_ns: int, *values: float) -> None:
        """Publish one message: header stamp [ns], then the fields in order."""
        if self._links is None:
            self._gathered.append(self._encode(stamp_ns, *values))
            if len(self._gathered) >= self._batch:
                self.flush()
            return
        if self._opens or self._answers:
            self._links.open = self._opens
        message = (stamp_ns, *values)
        self._local.hand_over(message + self._sender)
        self._links.later(self._publish, self._encode, message, answers=self._answers)

    def wait_until_received(self, seconds: float) -> None:
        """Wait until all readers have received the published messages, at most for a time [s]."""
        self._publisher.wait_for_all_acked(Duration(seconds=seconds))

    def flush(self) -> None:
        """Publish the gathered messages."""
        for message in self._gathered:
            self._publish(message)
        self._gathered.clear()

    def has_volatile_reader(self) -> bool:
        """Return whether a reader does not ask for the messages sent before it joined."""
        return any(map(is_volatile, self._node.get_subscriptions_info_by_topic(self.topic)))

    def destroy(self) -> None:
        """Destroy the publisher."""
        if self._links is not None:
            self._links.leave(self)
            self._local.leave()
        del self._publish
        self._node.destroy_publisher(self._publisher)


class Notice:
    """Publishes occasional messages, at once; readers in the same process receive them before that."""

    def __init__(self, node: Node, message: Any, topic: str, depth: int) -> None:
        """Create the publisher.

        Args:
            node: owner.
            message: message class.
            topic: name below the node's namespace.
            depth: messages kept for late joiners.
        """
        self._node = node
        links = links_of(node)
        self._local = None if links is None else links.topic(topic)
        if self._local is not None:
            self._local.senders += 1
        self.publisher = node.create_publisher(message, topic, control_qos(depth))

    def publish(self, message: Any, decoded: Any) -> None:
        """Publish a message.

        Args:
            message: ROS message.
            decoded: the same message as an :class:`Inbox` returns it.
        """
        if self._local is not None:
            self._local.hand_over(decoded)
        self.publisher.publish(message)

    def destroy(self) -> None:
        """Destroy the publisher."""
        if self._local is not None:
            self._local.leave()
        self._node.destroy_publisher(self.publisher)


class Inbox:
    """Receives one topic in the calling thread; messages from nodes of the same process come first, and not over DDS.

    It requests the messages sent before it joined as long as all publishers offer them. A publisher with ROS's default
    profile does not, and would never be matched; then a second, volatile subscription takes over. The first one is read until
    the second has at least as many publishers, so that no message of the others is lost.
    """

    def __init__(
        self,
        node: Node,
        message: Any,
        topic: str,
        qos: QoSProfile | None = None,
        decode: Callable[[bytes], Any] | None = None,
        *,
        owned: str | None = None,
    ) -> None:
        """Create a subscription without an executor.

        Args:
            node: owner; its executor serves the events of the subscription.
            message: message class.
            topic: name below the node's namespace, or absolute.
            qos: quality of service; that of the control path by default.
            decode: converts the bytes; by default to a tuple of the stamp, the leading numbers and the texts after them.
            owned: topic whose owner is the only accepted sender, identified by the last of the texts; None: this topic; empty:
                accept all senders, as where ``decode`` is given and where there are no texts.
        """
        check_for_type_support(message)
        self._node = node
        self._message = message
        self._topic = topic
        self._qos = qos or control_qos(_kept_by(node))
        standard = Decoder(message)
        self._decode: Callable[[bytes], Any] = decode or standard
        one_sender = decode is None and standard.texts > 0 and owned != ""
        owners = owners_of(node) if one_sender else None
        self._owner = None if owners is None else owners.of(owned or topic)
        # With the times at which they were sent.
        self._refused: deque[tuple[int, Message]] = deque(maxlen=self._qos.depth)
        self._again: deque[tuple[int, Message]] = deque()
        self._sent_ns = 0
        self.malformed = 0
        self._wider: Any = None
        self._widening = False
        self._taken_ns: set[int] = set()
        self._handlers: Sequence[Any] = []
        self.links = links_of(node)
        self.queue: deque[Message] = deque(maxlen=0)
        if self.links is not None:
            self._local = self.links.topic(topic)
            self.queue = self._local.open(self._qos.depth)
            self._own = self._local.named
        self.handle: Any = None
        if self.links is None:
            self._subscribe()
        else:
            self.links.watch(self)

    def look_outside(self) -> bool:
        """Subscribe if there is a publisher outside this process; return whether there is."""
        outside = self._node.count_publishers(self._topic) > self._local.senders
        if outside and self.handle is None:
            self._subscribe()
        return outside

    def _subscribe(self) -> None:
        """Subscribe, and watch for publishers that do not offer the requested policies."""
        self.handle = self._subscription()
        events = SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible, use_default_callbacks=False)
        self._handlers = events.create_event_handlers(self._node.default_callback_group, self.handle, self._topic)
        for handler in self._handlers:
            self._node.add_waitable(handler)

    def take(self) -> Any:
        """Return the next decoded message of the input's owner, or None.

        Messages that cannot be decoded are skipped and counted. Those of another sender are refused, but returned once that
        sender becomes the owner, as rows ahead of the cycles are sent only once.
        """
        if self._owner is None:
            return self._next()
        if self._refused and self._owner.may_take(self._refused[-1][1][-1]):
            holds = self._owner.holds
            self._again.extend((sent, message) for sent, message in self._refused if holds(message[-1], sent))
            self._refused.clear()
        while True:
            if self._again:
                self._sent_ns, message = self._again.popleft()
            elif (message := self._next()) is None:
                return None
            if self._owner.admits(message[-1], self._sent_ns):
                return message
            self._refused.append((self._sent_ns, message))

    def _next(self) -> Any:
        """Return the next decoded message, or None."""
        if self.queue:
            self._sent_ns = time.time_ns()
            return self.queue.popleft()
        if self.handle is None:
            return None
        while True:
            taken = self.take_raw()
            if taken is None:
                return None
            self._sent_ns = taken[1]["source_timestamp"]
            decoded = self._decode(taken[0])
            if decoded is None:
                self.malformed += 1
            elif self.links is None or not self._came_already(decoded):
                return decoded

    def _came_already(self, message: Any) -> bool:
        """Return whether a message is from a node of this process, which has already handed it over."""
        return isinstance(message, tuple) and message[-1] in self._own

    def take_raw(self) -> tuple[bytes, Mapping[str, int]] | None:
        """Return the next message's bytes and time stamps, or None."""
        while True:
            taken: tuple[bytes, Mapping[str, int]] | None = self.handle.take_message(self._message, True)
            if taken is None:
                if self._wider is not None and self._taken_over():
                    continue
                return None
            if self._widening:
                self._taken_ns.add(taken[1]["source_timestamp"])
            elif taken[1]["source_timestamp"] in self._taken_ns:
                continue
            return taken

    def publishers(self) -> int:
        """Return the number of publishers."""
        local = 0 if self.links is None else self._local.senders
        return local if self.handle is None else max(local, int(self.handle.get_publisher_count()))

    @property
    def volatile(self) -> bool:
        """Whether it does not receive messages sent before it was matched."""
        return bool(self._qos.durability == DurabilityPolicy.VOLATILE)

    def destroy(self) -> None:
        """Destroy the subscription."""
        if self.links is not None:
            self.links.forget(self)
            self._local.close(self.queue)
        if self.handle is None:
            return
        self._forget_events()
        self.handle.destroy_when_not_in_use()
        if self._wider is not None:
            self._wider.destroy_when_not_in_use()

    def _subscription(self) -> Any:
        profile = self._qos.get_c_qos_profile()
        with self._node.handle:
            return rclpy_implementation.Subscription(self._node.handle, self._message, self._topic, profile)

    def _on_incompatible(self, _: Any) -> None:
        """Subscribe without requesting earlier messages if a publisher does not offer them; runs in the service thread."""
        volatile = [info for info in self._node.get_publishers_info_by_topic(self._topic) if is_volatile(info)]
        if not volatile or self.volatile:
            return
        self._widening = True
        self._qos.durability = DurabilityPolicy.VOLATILE
        self._wider = self._subscription()
        self._node.get_logger().warning(
            f"{self._topic}: a publisher offers durability volatile, transient_local was asked for; it is accepted,"
            " but what is sent before a reader joins is lost to it: publish transient_local where that matters"
        )

    def _taken_over(self) -> bool:
        """Return whether the second subscription has all publishers and has taken over."""
        if self._wider.get_publisher_count() <= self.handle.get_publisher_count():
            return False
        self._forget_events()
        self.handle.destroy_when_not_in_use()
        self.handle, self._wider, self._widening = self._wider, None, False
        return True

    def _forget_events(self) -> None:
        for handler in self._handlers:
            self._node.remove_waitable(handler)
            handler.destroy()
        self._handlers = []


class Waiter:
    """Waits until any of several inboxes has a message; the other nodes of the process run first."""

    def __init__(self, inboxes: Sequence[Inbox]) -> None:
        """Create a wait set for the inboxes."""
        self.inboxes = inboxes
        self._links = inboxes[0].links
        self._room = len(inboxes)
        self._set = _wait_set(self._room)

    @property
    def arrived(self) -> bool:
        """Whether a node of this process has handed over a message."""
        return any(inbox.queue for inbox in self.inboxes)

    def wait(self, seconds: float) -> None:
        """Wait for a message, at most for a time [s]."""
        if self._links is not None:
            self._links.wait(self, seconds)
        else:
            self.block(seconds)

    def block(self, seconds: float, others: Sequence["Waiter"] = ()) -> None:
        """Wait for a message of another process, at most for a time [s], for these or other waiters' inboxes."""
        handles = [inbox.handle for waiter in (self, *others) for inbox in waiter.inboxes if inbox.handle is not None]
        if not handles:
            time.sleep(seconds)
            return
        if len(handles) > self._room:
            self._set.destroy_when_not_in_use()
            self._room = len(handles)
            self._set = _wait_set(self._room)
        self._set.clear_entities()
        for handle in handles:
            self._set.add_subscription(handle)
        self._set.wait(max(0, int(seconds * 1e9)))

    def destroy(self) -> None:
        """Destroy the wait set."""
        self._set.destroy_when_not_in_use()


def _wait_set(room: int) -> Any:
    """Return a wait set for a number of subscriptions."""
    return rclpy_implementation.WaitSet(room, 0, 0, 0, 0, 0, rclpy.get_default_context().handle)
