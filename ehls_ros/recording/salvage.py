"""The interface of the salvagers of both storages: messages as they are found, verified or not."""

from collections.abc import Callable, Iterator, Mapping
from mmap import mmap
from typing import NamedTuple

from ehls_ros.recording.ledger import Ledger


class Found(NamedTuple):
    """One message that may be kept.

    Attributes:
        topic: full name.
        stamp_ns: time of sending [ns].
        serialized: as CDR.
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
        """Unusable parts of the file, in words."""
        self.foreign: set[str] = set()
        """Topics that ehls_ros does not record."""

    def count(self, topic: str) -> None:
        """Count a damaged message."""
        self.damaged[topic] = self.damaged.get(topic, 0) + 1


Names = Mapping[int, str]
"""Full names of topics by their number in a file."""

Salvage = Callable[[mmap, Names, Ledger, Loss], Iterator[Found]]
"""Finds the messages in a storage file, in file order.

The arguments are the file's content, its topics, the ledger that verifies messages, and the record of damage, which is filled.
"""
