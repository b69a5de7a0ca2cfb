"""What connects the nodes of one process: messages handed over as they are, and published once nobody waits any more.

:class:`Links` is the post office; :mod:`ehls_ros.nodes.transport` uses it where a node has one, so that a node's loop does not
know whether its partners are in its process. :mod:`ehls_ros.nodes.composed` runs the loops.
"""

from collections import deque
from collections.abc import Callable, Collection
from typing import Any, Protocol

from ehls_ros.recording.topics import DEPTH

Message = tuple[Any, ...]
"""Header stamp [ns], the fields in order and, if the type has one, the sender."""


class Publisher(Protocol):
    """Publishes a message to other processes."""

    def publish(self, message: Message) -> None:
        """Encode and publish it."""


class Topic:
    """The readers of one topic in this process.

    Attributes:
        queues: of the readers.
        senders: number of open senders in this process.
    """

    def __init__(self) -> None:
        """Start without readers and senders."""
        self.queues: list[deque[Message]] = []
        self.senders = 0
        self._kept: deque[Message] = deque(maxlen=DEPTH)

    def hand_over(self, message: Message) -> None:
        """Give a message to all readers, and keep it for those that come later."""
        self._kept.append(message)
        for queue in self.queues:
            queue.append(message)

    def open(self, depth: int) -> deque[Message]:
        """Return the queue of a new reader, with what was sent before it came, as transient-local readers get it."""
        queue = deque(self._kept, maxlen=depth)
        self.queues = [*self.queues, queue]
        return queue

    def close(self, queue: deque[Message]) -> None:
        """Remove a reader."""
        self.queues = [other for other in self.queues if other is not queue]

    def leave(self) -> None:
        """Note that a sender is closed; what it kept goes with it."""
        self.senders -= 1
        if not self.senders:
            self._kept.clear()


class Links:
    """Connects the topics of the nodes of one process.

    Attributes:
        here: topics, by name, that only nodes of this process send: nothing of them is read over DDS.
        named: senders of this process, as messages name them: what they send comes back over DDS, and is left out.
        wait: what a loop does in place of waiting: ``wait(waiter, seconds)`` lets the other nodes do their part first.
    """

    def __init__(self, here: Collection[str], wait: Callable[[Any, float], None]) -> None:
        """Start without topics."""
        self.here = frozenset(here)
        self.named: set[str] = set()
        self.wait = wait
        self._topics: dict[str, Topic] = {}
        self._later: list[tuple[Publisher, Message]] = []

    def topic(self, name: str) -> Topic:
        """Return a topic by its name below the namespace."""
        return self._topics.setdefault(name, Topic())

    def later(self, publisher: Publisher, message: Message) -> None:
        """Publish a message with the next :meth:`publish`."""
        self._later.append((publisher, message))

    @property
    def pending(self) -> int:
        """Number of messages yet to be published."""
        return len(self._later)

    def publish(self) -> None:
        """Publish what has gathered, in the order of sending."""
        gathered, self._later = self._later, []
        for publisher, message in gathered:
            publisher.publish(message)
