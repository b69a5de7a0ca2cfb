"""What the salvaging of either storage gives: messages as they are found, each with what is known of its soundness."""

from collections.abc import Mapping
from typing import NamedTuple


class Found(NamedTuple):
    """One message that may be kept.

    Attributes:
        topic: full name.
        stamp_ns: when it was sent [ns].
        serialized: as CDR.
        verified: whether a checksum says that it is as it was written; otherwise there is none to ask.
    """

    topic: str
    stamp_ns: int
    serialized: bytes
    verified: bool


class Loss:
    """What was found to be damaged on the way; it is filled while messages are being found."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.damaged: dict[str, int] = {}
        """Messages that are not as they were written, by the topic's full name."""
        self.places: list[str] = []
        """Parts of the file that cannot be used, in words."""

        self.foreign: set[str] = set()
        """Topics that ehls_ros does not record."""

    def count(self, topic: str) -> None:
        """Count a damaged message."""
        self.damaged[topic] = self.damaged.get(topic, 0) + 1


Names = Mapping[int, str]
"""Full names of topics by their number in a file."""
