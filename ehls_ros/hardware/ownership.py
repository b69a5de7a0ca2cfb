"""Ownership of a node's input: the one sender from which it is accepted, until that sender leaves.

Commands follow a different rule (:mod:`ehls_ros.hardware.command_intake`), which also considers whether the valve is open.
Every other input of the control cycle, such as a reference or a disturbance, follows this one:

* The first sender becomes the owner. Messages of others are refused.
* The input becomes free when the owner announces its departure, or is gone from the graph. Earlier messages of a refused
  sender are then accepted, unless that sender has left since it sent them: they may be read long after its announcement.
  That compares the sender's clock with the reader's: clocks of several hosts must be synchronised.
* A sender of the owner's node name takes over once the owner has been silent for :data:`RESTART`: the node was restarted.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

RESTART = 0.5
"""Silence of the owner after which a sender of the same node name counts as that node, restarted [s]; a start takes longer."""

REMAINDER = 0.5
"""Time in which messages may still arrive from an owner that has left or was killed [s]."""

MOST_CONTENDERS = 16
"""Number of senders remembered; a sender could use a new name in each message."""

SILENT = 1.0
"""Silence of the owner after which it may have left without an announcement [s]."""


def node_of(sender: str) -> str:
    """Return the node name of a sender ``<full name of the node>-<process>``; the sender itself if it has another form."""
    name, _, process = sender.rpartition("-")
    return name if process.isdigit() else sender


def process_of(sender: str) -> int | None:
    """Return the process number in a sender's name; None if there is none."""
    process = sender.rpartition("-")[2]
    return int(process) if process.isdigit() else None


class MessageTimes(NamedTuple):
    """Times of the messages of a sender [s].

    Attributes:
        first: of the first one.
        last: of the last one.
    """

    first: float
    last: float


class Ownership:
    """Owner and contenders of one input.

    Attributes:
        owner: the sender whose messages are accepted; None: the first to send.
        contenders: the senders refused since the owner took the input.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without an owner; ``clock`` returns a monotonic time [s]."""
        self._clock = clock
        self._last_message = -float("inf")
        self._left: tuple[str | None, float] = None, -float("inf")
        self._departures: dict[str, int] = {}
        self.owner: str | None = None
        self.contenders: dict[str, MessageTimes] = {}

    def admits(self, sender: str, sent_ns: int | None = None) -> bool:
        """Return whether a sender's message is accepted, and note its arrival.

        Args:
            sender: name of the sender.
            sent_ns: time at which it sent the message, by its system clock [ns]; None: just now.
        """
        now = self._clock()
        if sender == self.owner:
            self._last_message = now
            return True
        owner = self.owner
        outdated = sent_ns is not None and self.has_left_since(sender, sent_ns)
        if owner is None or (node_of(owner) == node_of(sender) != "" and now - self._last_message > RESTART):
            if owner is None and (self._is_remainder(sender, now) or (outdated and sender == self._left[0])):
                return True
            if outdated:
                return False
            self.owner, self._last_message = sender, now
            self.contenders.clear()
            return True
        if not outdated and not self._is_remainder(sender, now):
            before = self.contenders.get(sender, MessageTimes(now, now))
            self.contenders[sender] = MessageTimes(now if now - before.last > SILENT else before.first, now)
            if len(self.contenders) > MOST_CONTENDERS:
                del self.contenders[min(self.contenders, key=lambda name: self.contenders[name].last)]
        return False

    def _is_remainder(self, sender: str, now: float) -> bool:
        """Return whether a message was still under way when its sender left."""
        left, when = self._left
        return left == sender and now - when <= REMAINDER

    @property
    def silent(self) -> bool:
        """Whether the owner has sent no message for :data:`SILENT`."""
        return self.owner is not None and self._clock() - self._last_message > SILENT

    def must_yield(self, sender: str) -> bool:
        """Return whether a contender has to stop: the owner has continued for :data:`REMAINDER` alongside it."""
        times = self.contenders.get(sender)
        return times is not None and self._last_message - times.first > REMAINDER

    @property
    def contender(self) -> str | None:
        """The contender of the latest message, if that was within :data:`SILENT`; None otherwise."""
        lately = {
            sender: times.last for sender, times in self.contenders.copy().items() if self._clock() - times.last <= SILENT
        }
        return max(lately, key=lately.__getitem__) if lately else None

    def has_left_since(self, sender: str, sent_ns: int) -> bool:
        """Return whether a sender has left since it sent a message [ns]."""
        return self._departures.get(sender, -1) >= sent_ns

    def release(self, sender: str, left_ns: int) -> None:
        """Free the input if a sender owns it: it has left.

        Args:
            sender: name of the sender.
            left_ns: time at which it had left, by the system's clock [ns].
        """
        self.contenders.pop(sender, None)
        # The latest last.
        self._departures.pop(sender, None)
        self._departures[sender] = left_ns
        if len(self._departures) > MOST_CONTENDERS:
            del self._departures[next(iter(self._departures))]
        # At the beginning, an announcement that is kept from before may be of a sender that has returned since.
        if sender == self.owner or (self.owner is None and self._left[0] is None):
            self._left = sender, self._clock()
        if sender == self.owner:
            self.owner = None
