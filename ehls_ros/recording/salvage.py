"""Interface of the salvage functions of both storages: found messages, verified or not, and a bound on the work."""

from collections.abc import Callable, Iterator, Mapping
from mmap import mmap
from typing import NamedTuple

from rosbags.interfaces import MessageDefinition

from ehls_ros.recording.ledger import Ledger

MAX_NAME = 1024
"""Longest name of a topic [characters]; ROS 2 permits 255."""

MAX_WORK = 16
"""Maximum number of bytes copied and compared with the ledger, relative to the size of the file.

Each byte belongs to one message, so a damaged file needs about one. In a malicious file, messages that begin inside each other
would take the square of its size.
"""

SPENT = "messages begin inside each other in too many places: the rest is not searched for more"
"""Remark on a file that exceeds the bound."""


class Kind(NamedTuple):
    """Type of a topic's messages.

    Attributes:
        type: name of the type.
        definition: its definition in the file; without text if it is one of the known types.
    """

    type: str
    definition: MessageDefinition


class Found(NamedTuple):
    """One message that may be kept.

    Attributes:
        topic: full name.
        stamp_ns: time of sending [ns].
        serialized: message as CDR.
        verified: whether a checksum confirms it; if not, there is no checksum for it.
    """

    topic: str
    stamp_ns: int
    serialized: bytes
    verified: bool


class Loss:
    """Damage found so far; filled while messages are being found."""

    def __init__(self) -> None:
        """Start without damage."""
        self.damaged: dict[str, int] = {}
        """Number of altered messages, by the topic's full name."""
        self.places: list[str] = []
        """Descriptions of unusable parts of the file."""
        self.foreign: set[str] = set()
        """Topics that ehls_ros does not record."""

    def count(self, topic: str) -> None:
        """Count a damaged message."""
        self.damaged[topic] = self.damaged.get(topic, 0) + 1


class Budget:
    """Bound on the bytes copied and compared in the search for messages, by the size of the file."""

    def __init__(self, content: mmap, loss: Loss) -> None:
        """Start with :data:`MAX_WORK` times the size of a file.

        Args:
            content: content of the file.
            loss: receives a remark when the budget is exhausted.
        """
        self._left = MAX_WORK * len(content)
        self._loss = loss

    def covers(self, size: int) -> bool:
        """Deduct the size of another candidate, and return whether it may be examined; once exhausted, the budget stays so.

        Args:
            size: size of the candidate [B].
        """
        if self._left >= 0:
            self._left -= size
            if self._left < 0:
                self._loss.places.append(SPENT)
        return self._left >= 0


Names = Mapping[int, str]
"""Full names of topics by their number in a file."""

Salvage = Callable[[mmap, Names, Ledger, Loss], Iterator[Found]]
"""Function that finds the messages in a storage file, in file order.

The arguments are the file's content, its topics, the ledger that verifies messages, and the record of damage, which is filled.
"""
