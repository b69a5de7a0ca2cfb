"""Links between the nodes of one process: messages are handed over unencoded, and published once no node waits any more.

:class:`Links` delivers the messages; :mod:`ehls_ros.nodes.transport` uses it where a node has one, so that a node's loop does
not depend on where its partners run. :mod:`ehls_ros.nodes.composed` runs the loops.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from ehls_ros.recording.topics import DEPTH

Message = tuple[Any, ...]
"""Header stamp [ns], the fields in order and, if the type has one, the sender."""


PATIENCE = 1.0
"""Longest wait for readers to receive the published messages [s]: a hung reader must not block the others for good."""

LEAST_PAUSE = 4e-4
"""Shortest pause of the loops in which the service thread can complete a step [s]; PAUSE_SHARE applies if that is shorter."""

PAUSE_SHARE = 0.4
"""Shortest pause as a fraction of the control period: the loops of a fast one never pause for longer."""

PAUSE_WAIT = 2e-3
"""Longest wait for a pause [s]: without one, the service thread must proceed too; an emergency stop may be next."""

Encode = Callable[..., bytes]
Publish = Callable[[bytes], None]
"""Functions that encode a message and publish it to other processes."""


class Topic:
    """The readers of one topic in this process.

    Attributes:
        queues: of the readers.
        senders: number of open senders in this process.
        named: names of those senders in messages; their messages would return over DDS and are left out.
    """

    def __init__(self) -> None:
        """Start without readers and senders."""
        self.queues: list[deque[Message]] = []
        self.senders = 0
        self.named: set[str] = set()
        self._kept: deque[Message] = deque(maxlen=DEPTH)

    def hand_over(self, message: Message) -> None:
        """Give a message to all readers, and keep it for late joiners."""
        self._kept.append(message)
        for queue in self.queues:
            queue.append(message)

    def open(self, depth: int) -> deque[Message]:
        """Return the queue of a new reader, filled with earlier messages, as transient-local readers receive them."""
        queue = deque(self._kept, maxlen=depth)
        self.queues = [*self.queues, queue]
        return queue

    def close(self, queue: deque[Message]) -> None:
        """Remove a reader."""
        self.queues = [other for other in self.queues if other is not queue]

    def leave(self) -> None:
        """Note that a sender is closed; after the last one, drop the messages kept."""
        self.senders -= 1
        if not self.senders:
            self._kept.clear()


class Reader(Protocol):
    """Reader of a topic that reads over DDS too if necessary."""

    def look_outside(self) -> bool:
        """Read over DDS too if there is a publisher outside this process; return whether it does."""


class Sender(Protocol):
    """Publisher of a topic."""

    def wait_until_received(self, seconds: float) -> None:
        """Wait until all readers have received the published messages, at most for a time [s]."""


class Links:
    """Connects the topics of the nodes of one process.

    Attributes:
        kept: messages that a publisher keeps for readers that have not received them yet, and for late joiners.
        open: whether a snapshot has been sent that has no answer yet.
        apart: whether a node of another process takes part: it sends messages read here.
        wait: called in place of waiting: ``wait(waiter, seconds)`` runs the other nodes first.
    """

    def __init__(
        self, wait: Callable[[Any, float], None], kept: int = DEPTH, *, patient: bool = False, period: float = math.inf
    ) -> None:
        """Start without topics.

        Args:
            wait: see above.
            kept: see above.
            patient: whether to wait for the readers before dropping a message that one has not received; not possible where
                cycles follow the wall clock.
            period: control period [s].
        """
        self._least_pause = min(LEAST_PAUSE, PAUSE_SHARE * period)
        self.kept = kept
        self._patient = patient
        self._unconfirmed = 0
        self._senders: list[Sender] = []
        # Held while the loops wait for readers: meanwhile, a lifecycle request to a node must not destroy its publishers.
        self._waiting = threading.Lock()
        self.open = False
        self.apart = False
        self._wanted = False
        self._pause = threading.Event()
        self.wait = wait
        self._topics: dict[str, Topic] = {}
        self._later: list[tuple[Publish, Encode, Message]] = []
        self._answers: list[tuple[Publish, Encode, Message]] = []
        self._readers: list[Reader] = []
        self._looking = threading.Lock()

    def topic(self, name: str) -> Topic:
        """Return a topic by its name below the namespace."""
        return self._topics.setdefault(name, Topic())

    def watch(self, reader: Reader) -> None:
        """Register a reader to look for publishers outside this process, now and until there is one."""
        with self._looking:
            self._readers.append(reader)
            self.apart = reader.look_outside() or self.apart

    def forget(self, reader: Reader) -> None:
        """Unregister a reader."""
        with self._looking:
            self._readers = [other for other in self._readers if other is not reader]

    def look_outside(self) -> None:
        """Let all readers look for outside publishers; called at intervals by the thread that serves the nodes."""
        with self._looking:
            outside = [reader.look_outside() for reader in self._readers]
        self.apart = any(outside)

    def await_pause(self) -> None:
        """Wait until the loops begin a pause; for the service thread, which delays an answer while it holds the interpreter.

        In lockstep the loops never pause, and response times do not matter.
        """
        if not self._patient:
            self._pause.clear()
            self._wanted = True
            self._pause.wait(PAUSE_WAIT)

    def begin_pause(self, seconds: float) -> None:
        """Signal to the service thread that the loops pause now, at most for a time [s]."""
        if self._wanted and seconds > self._least_pause:
            self._wanted = False
            self._pause.set()

    def later(self, publish: Publish, encode: Encode, message: Message, *, answers: bool = False) -> None:
        """Publish a message with the next :meth:`publish`.

        Args:
            publish: publishes bytes.
            encode: converts the message to bytes.
            message: the message, without a sender.
            answers: whether it answers a snapshot. Answers are published first, so that the time between the two is not
                mistaken for the response time: the answer has been handed over before.
        """
        (self._answers if answers else self._later).append((publish, encode, message))

    @property
    def pending(self) -> int:
        """Number of messages yet to be published."""
        return len(self._answers) + len(self._later)

    def publish(self) -> None:
        """Publish the gathered messages, in the order of sending, answers first; for the thread of the loops only."""
        gathered, self._answers, self._later = [*self._answers, *self._later], [], []
        for publish, encode, message in gathered:
            publish(encode(*message))
        self._unconfirmed += len(gathered)
        # A cycle has at least four topics, and a burst of rows ahead is short compared with the history kept.
        if self._patient and self._unconfirmed >= 3 * self.kept:
            self._unconfirmed = 0
            with self._waiting:
                for sender in self._senders:
                    sender.wait_until_received(PATIENCE)

    def join(self, sender: Sender) -> None:
        """Add the publisher of a topic."""
        with self._waiting:
            self._senders = [*self._senders, sender]

    def leave(self, sender: Sender) -> None:
        """Remove a publisher, which may be destroyed then; the loop of its node has ended and published everything."""
        with self._waiting:
            self._senders = [other for other in self._senders if other is not sender]
