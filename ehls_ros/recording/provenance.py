"""What ehls_ros itself keeps in a bag: the configuration, and seals that show whether every message is as written.

It stands in the ``custom_data`` of the bag's metadata as one JSON text and the checksum of that text. rosbags writes no
checksums of its own, so that without the seals a flipped bit in a bag would be a measured value.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from hashlib import blake2b
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ehls_ros.errors import BadInput

KEY = "ehls_ros"
CHECKSUM_KEY = "ehls_ros_checksum"

_LARGEST = (1 << 64) - 1


class Seal(NamedTuple):
    """What one topic of a bag was when the bag was closed.

    Attributes:
        type_hash: RIHS01 hash of its message type.
        checksum: sum of :func:`message_checksum` over its messages, 64 bits; their order does not matter.
        messages: number of its messages.
        newest_ns: latest time of sending [ns].
    """

    type_hash: str
    checksum: int
    messages: int
    newest_ns: int


class Provenance(NamedTuple):
    """Where a bag comes from.

    Attributes:
        configuration: what the run was made with: rig, spec, controller, versions; JSON values.
        seals: one a topic, by its full name.
        signals: the signals the bag was written from, when it was written from a trajectory: a message has all its
            fields even where the trajectory had not all signals.
        recovery: what was lost, where the bag was made of a damaged one, JSON values.
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


_PROVENANCE = TypeAdapter(Provenance)


def provenance_in(custom_data: Mapping[str, str], where: str) -> Provenance | None:
    """Read the entries back.

    Args:
        custom_data: entries of a bag's metadata, ours or not.
        where: the bag, for the error.

    Returns:
        The provenance, or None when another recorder wrote the bag.

    Raises:
        BadInput: the entries are damaged.
    """
    if KEY not in custom_data and CHECKSUM_KEY not in custom_data:
        return None
    content = str(custom_data.get(KEY, ""))
    if custom_data.get(CHECKSUM_KEY) != _text_checksum(content):
        raise BadInput("the configuration kept in the bag is damaged", where, "a bag as it was written")
    try:
        return _PROVENANCE.validate_json(content)
    except ValidationError:
        raise BadInput("the configuration kept in the bag is none of ours", where, "a bag as it was written") from None


def message_digest(topic: str, stamp_ns: int, serialized: bytes | memoryview) -> bytes:
    """Return 64 bits of BLAKE2 over one message together with its topic and its time of sending.

    Args:
        topic: full name.
        stamp_ns: time of sending [ns].
        serialized: the message as CDR.
    """
    stamp = (stamp_ns & _LARGEST).to_bytes(8, "little")
    return blake2b(b"".join((stamp, topic.encode(), b"\0", serialized)), digest_size=8).digest()


def message_checksum(topic: str, stamp_ns: int, serialized: bytes | memoryview) -> int:
    """Return the :func:`message_digest` as a number."""
    return int.from_bytes(message_digest(topic, stamp_ns, serialized), "little")


def checksum_sum(checksums: Iterable[int]) -> int:
    """Return the sum of checksums, in 64 bits."""
    return sum(checksums) & _LARGEST


def checksum_of(content: bytes) -> int:
    """Return 64 bits of BLAKE2 over some bytes."""
    return int.from_bytes(blake2b(content, digest_size=8).digest(), "little")


def _text_checksum(content: str) -> str:
    # the letters keep a YAML parser from taking it for a number
    return f"crc32-{crc32(content.encode()):08x}"


def as_json(configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration as JSON gives it back: tuples as lists, numpy's numbers and arrays as plain ones.

    Args:
        configuration: nested mappings, sequences, texts and numbers.

    Raises:
        TypeError: it holds something else.
    """
    content: dict[str, Any] = json.loads(json.dumps(dict(configuration), default=_plain))
    return content


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} in a bag's configuration is no JSON value")
