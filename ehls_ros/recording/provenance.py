"""Provenance of a bag: the configuration of the run, and seals that reveal altered messages.

It is stored in the ``custom_data`` of the bag's metadata as one JSON text and its checksum. rosbags writes no checksums, so
without the seals a flipped bit would pass for a measured value.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from hashlib import blake2b
from typing import Any, NamedTuple, cast
from zlib import crc32

import numpy as np

from ehls_ros.errors import BadInput
from ehls_ros.schema import from_json

KEY = "ehls_ros"
CHECKSUM_KEY = "ehls_ros_checksum"

_LARGEST = (1 << 64) - 1


class Seal(NamedTuple):
    """State of one topic when the bag was closed.

    Attributes:
        type_hash: RIHS01 hash of the message type.
        checksum: sum of :func:`message_checksum` over the messages, 64 bits; independent of their order.
        messages: number of messages.
        newest_ns: latest time of sending [ns].
    """

    type_hash: str
    checksum: int
    messages: int
    newest_ns: int


class Provenance(NamedTuple):
    """Origin of a bag.

    Attributes:
        configuration: configuration of the run: rig, spec, controller, versions; JSON values.
        seals: seals of the topics, by full name.
        signals: signals of the trajectory from which the bag was written; the messages have all fields, also those without a
            signal. None for a recording.
        recovery: losses, if the bag was recovered from a damaged one; JSON values.
    """

    configuration: Mapping[str, Any]
    seals: Mapping[str, Seal]
    signals: Sequence[str] | None
    recovery: Mapping[str, Any] | None = None

    def custom_data(self) -> dict[str, str]:
        """Return the entries for the bag's metadata."""
        seals = {topic: seal._asdict() for topic, seal in self.seals.items()}
        content = json.dumps({**self._asdict(), "seals": seals})
        return {KEY: content, CHECKSUM_KEY: _text_checksum(content)}


def provenance_in(custom_data: Mapping[str, str], where: str) -> Provenance | None:
    """Read the provenance from a bag's metadata.

    Args:
        custom_data: entries of the metadata of any bag.
        where: the bag, for the error.

    Returns:
        The provenance; None if another recorder wrote the bag.

    Raises:
        BadInput: the entries are damaged.
    """
    if KEY not in custom_data and CHECKSUM_KEY not in custom_data:
        return None
    content = str(custom_data.get(KEY, ""))
    if custom_data.get(CHECKSUM_KEY) != _text_checksum(content):
        raise BadInput("the configuration in the bag is damaged", where, "an unaltered bag")
    try:
        return cast(Provenance, from_json(Provenance, content))
    except ValueError:
        raise BadInput("the configuration in the bag is not in the format of ehls_ros", where, "an unaltered bag") from None


def message_digest(topic: str, stamp_ns: int, serialized: bytes | memoryview) -> bytes:
    """Return 64 bits of BLAKE2 over a message, its topic and its time of sending.

    Args:
        topic: full name.
        stamp_ns: time of sending [ns].
        serialized: the message as CDR.
    """
    stamp = (stamp_ns & _LARGEST).to_bytes(8, "little")
    return blake2b(b"".join((stamp, topic.encode(), b"\0", serialized)), digest_size=8).digest()


def message_checksum(topic: str, stamp_ns: int, serialized: bytes | memoryview) -> int:
    """Return :func:`message_digest` as a number."""
    return int.from_bytes(message_digest(topic, stamp_ns, serialized), "little")


def checksum_sum(checksums: Iterable[int]) -> int:
    """Return the sum of checksums modulo 2^64."""
    return sum(checksums) & _LARGEST


def checksum_of(content: bytes) -> int:
    """Return 64 bits of BLAKE2 over ``content``."""
    return int.from_bytes(blake2b(content, digest_size=8).digest(), "little")


def _text_checksum(content: str) -> str:
    # The prefix keeps YAML parsers from reading it as a number.
    return f"crc32-{crc32(content.encode()):08x}"


def as_json(configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration as JSON values: tuples as lists, numpy numbers and arrays as plain ones.

    Args:
        configuration: nested mappings, sequences, strings and numbers.

    Raises:
        TypeError: it contains anything else.
    """
    content: dict[str, Any] = json.loads(json.dumps(dict(configuration), default=_plain))
    return content


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} in a bag's configuration is not a JSON value")
