"""Streaming of trajectories to Foxglove, or any client of its WebSocket protocol, without ROS.

The messages are those of the node graph, with the same topics and schemas as a bag, so that one layout shows both. All sources
share the clock of the samples, so that a recording and a simulation can be overlaid.
"""

import heapq
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from types import TracebackType
from typing import NamedTuple, Self

import foxglove
from foxglove.websocket import Capability, ChannelView, Client, ServerListener

from ehls_ros.errors import BadInput
from ehls_ros.process import Stopping
from ehls_ros.recording.topics import CYCLE_TOPICS, RESPONSE, Topic
from ehls_ros.recording.trajectory_messages import streams_of
from ehls_ros.recording.typestore import typestore
from ehls_ros.trajectory import Trajectory

TICK = 0.02
"""Interval over which due messages are collected before they are sent [s]."""

SUBSCRIPTION_TIME = 0.2
"""Time without a new subscription after which a viewer's subscriptions count as complete [s]."""

BACKLOG = 100_000
"""Maximum number of messages queued for a slow viewer; beyond that the oldest are dropped."""

STRETCH = 2000
"""Number of samples converted to messages at a time."""

Message = tuple[int, str, bytes]
"""Time [ns], topic with its namespace, and content as CDR."""


class Source(NamedTuple):
    """A stream in one namespace.

    Attributes:
        namespace: namespace of its topics, such as ``/ehls``.
        start_s: clock time at which it begins [s].
        stretches: restarts from the beginning and returns the trajectory piece by piece; its times may start anywhere.
    """

    namespace: str
    start_s: float
    stretches: Callable[[], Iterator[Trajectory]]


def in_stretches(trajectory: Trajectory) -> Iterator[Trajectory]:
    """Divide a trajectory into pieces that convert to messages quickly."""
    for first in range(0, len(trajectory), STRETCH):
        rows = slice(first, first + STRETCH)
        yield Trajectory(trajectory.time_s[rows], {name: values[rows] for name, values in trajectory.signals.items()})


def messages_of(source: Source) -> Iterator[Message]:
    """Yield a source's messages in order of time.

    Raises:
        BadInput: the source has values that messages cannot express.
    """
    first = 0
    offset = 0.0
    for stretch in source.stretches():
        if first == 0:
            offset = source.start_s - stretch.time_s[0]
        # The send time of a command is not used; the command appears at its sample, like all other signals.
        signals = {name: values for name, values in stretch.signals.items() if name != RESPONSE}
        time_s = stretch.time_s + offset if offset else stretch.time_s
        due: list[Message] = []
        for stream in streams_of(Trajectory(time_s, signals), source.namespace, first):
            topic = stream.topic.resolve(source.namespace)
            due += zip(stream.sent_ns.tolist(), [topic] * len(stream.messages), stream.messages, strict=True)
        yield from sorted(due, key=itemgetter(0))
        first += len(stretch)


def topics_of(trajectory: Trajectory) -> list[Topic]:
    """Return the topics with signals of a trajectory."""
    return [topic for topic in CYCLE_TOPICS if trajectory.signals.keys() & set(topic.signals.values())]


def play(
    messages: Iterable[Message],
    rate: float,
    publish: Callable[[Message], None],
    tell_time: Callable[[int], None],
    stopping: Stopping,
) -> None:
    """Publish messages when they are due, never earlier and at most :data:`TICK` later.

    Args:
        messages: messages in order of time.
        rate: seconds of the messages' clock per second of wall clock.
        publish: called with each message.
        tell_time: called with the clock time [ns].
        stopping: ends playback once it is set.
    """
    began = time.perf_counter()
    first_ns: int | None = None
    for message in messages:
        now_ns = message[0]
        if first_ns is None:
            first_ns, began = now_ns, time.perf_counter()
        ahead = (now_ns - first_ns) * 1e-9 / rate - (time.perf_counter() - began)
        if ahead > 0.0:
            tell_time(now_ns)
            stopping.wait(ahead + TICK)
        if stopping.is_set():
            return
        publish(message)


class Viewers(ServerListener):
    """The connected viewers."""

    def __init__(self) -> None:
        """Start without a viewer."""
        self._changed = threading.Condition()
        self._asked: set[tuple[int, int]] = set()
        self._since = 0.0

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Register a subscription."""
        with self._changed:
            self._asked.add((client.id, channel.id))
            self._since = time.monotonic()
            self._changed.notify_all()

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Remove a subscription that was withdrawn, or whose viewer has disconnected."""
        with self._changed:
            self._asked.discard((client.id, channel.id))
            self._changed.notify_all()

    def present(self) -> bool:
        """Return whether a viewer is connected and its subscriptions are complete."""
        with self._changed:
            return bool(self._asked) and time.monotonic() - self._since > SUBSCRIPTION_TIME

    def wait(self, *, present: bool, stopping: Stopping) -> None:
        """Wait until a viewer is present, or none is, or until a stop is requested."""
        while self.present() != present and not stopping.is_set():
            with self._changed:
                self._changed.wait(TICK)


class FoxgloveServer:
    """Read-only server for any viewer: it accepts no messages, parameters or services."""

    def __init__(self, host: str, port: int, topics: Mapping[str, Sequence[Topic]]) -> None:
        """Start listening and advertise the topics.

        Args:
            host: address to listen on.
            port: port to listen on; 0: any free one.
            topics: topics by namespace.

        Raises:
            BadInput: it cannot listen there.
        """
        self.viewers = Viewers()
        # Keep a reference: a garbage-collected context advertises nothing.
        self._context = foxglove.Context()
        self._channels = {
            topic.resolve(namespace): foxglove.Channel(
                topic.resolve(namespace), message_encoding="cdr", schema=_schema(topic), context=self._context
            )
            for namespace, chosen in topics.items()
            for topic in chosen
        }
        try:
            self._server = foxglove.start_server(
                name="ehls_ros",
                host=host,
                port=port,
                capabilities=[Capability.Time],
                server_listener=self.viewers,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise BadInput(
                f"nothing can be served ({error})", f"{host}:{port}", "a free port of this machine (--port)"
            ) from None

    @property
    def port(self) -> int:
        """Port of the server."""
        return self._server.port

    def publish(self, message: Message) -> None:
        """Send a message."""
        time_ns, topic, data = message
        self._channels[topic].log(data, log_time=time_ns)

    def tell_time(self, time_ns: int) -> None:
        """Send the clock time."""
        self._server.broadcast_time(time_ns)

    def __enter__(self) -> Self:
        """Return the server."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the server."""
        self._server.stop()
        for channel in self._channels.values():
            channel.close()


def serve(server: FoxgloveServer, sources: Sequence[Source], rate: float, stopping: Stopping) -> None:
    """Play back while a viewer is present, and again for the next one after all have disconnected, until stopped.

    Args:
        server: the server.
        sources: the streams, all on one clock.
        rate: seconds of the clock per second of wall clock.
        stopping: ends it once it is set.

    Raises:
        BadInput: a source has values that messages cannot express.
    """
    while not stopping.is_set():
        server.viewers.wait(present=True, stopping=stopping)
        messages = heapq.merge(*map(messages_of, sources), key=itemgetter(0))
        play(messages, rate, server.publish, server.tell_time, stopping)
        server.viewers.wait(present=False, stopping=stopping)


def _schema(topic: Topic) -> foxglove.Schema:
    text, _ = typestore().generate_msgdef(topic.type, ros_version=2)
    return foxglove.Schema(name=topic.type, encoding="ros2msg", data=text.encode())
