"""One topic of a bag being read: its messages converted to columns and checked against the bag's seals."""

from collections.abc import Collection, Mapping, Sequence
from itertools import repeat
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, ConnectionExtRosbag2

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording import limits
from ehls_ros.recording.alignment import CYCLE, NANOSECONDS, SECONDS, SENT, MessageColumns
from ehls_ros.recording.cdr import CdrError, Field, decode, flatten
from ehls_ros.recording.entries import FRAME, decode_entries, every_entry, frames
from ehls_ros.recording.provenance import Seal, checksum_sum, message_checksum
from ehls_ros.recording.storage_file import CLOSED_BAG
from ehls_ros.recording.topics import CONTROLLER_STATUS, SENDER, Topic
from ehls_ros.recording.typestore import typestore, typestore_of

EARLIER_UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {CONTROLLER_STATUS.name: {"e3": 1e6, "s": 1e6, "u1": 1e9, "u2": 1e9, "u3": 1e9}}
)
"""SI value of a field's unit in old bags, whose messages do not name their sender: MPa, MPa/s and t MPa/s^2."""

BLOCK = 16384
"""Messages decoded together: enough to amortize the overhead, few enough for a small memory footprint."""


class BagTopic:
    """The messages of one topic, in order of arrival."""

    def __init__(
        self,
        connections: Sequence[Connection],
        fields: Sequence[Field],
        wanted: Collection[str],
        seal: Seal | None,
        where: str,
        units: Mapping[str, float] = MappingProxyType({}),
        entries: Collection[str] | int = (),
        skip_empty: bool = False,
    ) -> None:
        """Prepare for the topic's messages.

        Args:
            connections: the bag's entries for it, one or more.
            fields: of its messages.
            wanted: names of the fields to read.
            seal: state of the topic when the bag was closed, if known.
            where: bag and full name of the topic, for errors.
            units: SI values of units other than 1, by field.
            entries: names of the entries of sequences to read, and :data:`FRAME` for the frames; or the number of entries to
                read of every sequence.
            skip_empty: leave out messages without content; otherwise they are refused.

        Raises:
            BadInput: the topic has too many messages, or they are not serialized as CDR.
        """
        formats = {c.ext.serialization_format for c in connections if isinstance(c.ext, ConnectionExtRosbag2)} - {"cdr"}
        if formats:
            raise BadInput(f"its messages are serialized as {formats.pop()}", where, "cdr")
        self._where = where
        self._path, self._type = connections[0].topic, connections[0].msgtype
        self._expected = sum(connection.msgcount for connection in connections)
        if self._expected > limits.ROWS:
            expected = f"at most {limits.ROWS}; split a longer recording into several bags"
            raise BadInput(f"it has {self._expected} messages", where, expected)
        self._seal = seal
        self._fields = fields
        self._wanted = wanted
        self._units = units
        self._entries = entries
        self._skip_empty = skip_empty
        self._empty = 0
        self._checksum = 0
        self._count = 0
        self._stamps_ns: list[int] = []
        self._messages: list[bytes] = []
        self._gathered = 0
        self._blocks: list[dict[str, NDArray[Any]]] = []

    def add(self, stamp_ns: int, message: bytes) -> None:
        """Add the next message.

        Args:
            stamp_ns: time of sending [ns].
            message: the message as CDR.

        Raises:
            BadInput: this message is too large, or an earlier one is not of the topic's type.
        """
        try:
            size = len(message)
        except TypeError as error:
            # SQLite may return a number or None instead of bytes.
            raise BadInput(reason(error), self._where, f"messages of type {self._type}") from None
        if size > limits.MESSAGE:
            expected = f"at most {limits.MESSAGE} for type {self._type}"
            raise BadInput(f"a message has {size} bytes", self._where, expected)
        if size == 0 and self._skip_empty:
            self._empty += 1
            return
        self._stamps_ns.append(stamp_ns)
        self._messages.append(message)
        self._gathered += size
        if len(self._messages) == BLOCK or self._gathered > limits.GATHERED:
            self._decode()

    def columns(self) -> MessageColumns:
        """Return all messages.

        Raises:
            BadInput: the messages differ from those in the closed bag.
        """
        self._decode()
        if self._count + self._empty != self._expected:
            raise BadInput(f"{self._count + self._empty} of {self._expected} messages are there", self._where, CLOSED_BAG)
        if self._seal is not None and self._seal.checksum != self._checksum:
            raise BadInput("messages have been altered since they were written", self._where, "an undamaged bag")
        names = dict.fromkeys(name for block in self._blocks for name in block)
        if len(names) * self._count > limits.VALUES:
            expected = f"at most {limits.VALUES} values: split the recording into several bags"
            raise BadInput(f"it has {self._count} messages of {len(names)} different entries", self._where, expected)
        columns = {name: _stacked([_values(block, name) for block in self._blocks]) for name in names}
        return columns | {name: columns[name] * unit for name, unit in self._units.items() if name in columns}

    def remarks(self) -> list[str]:
        """Return remarks on messages left out."""
        return [f"{self._empty} messages are empty and left out"] if self._empty else []

    def _decode(self) -> None:
        try:
            block = decode(self._messages, self._fields, self._wanted)
            if isinstance(self._entries, int):
                block |= every_entry(self._messages, self._fields, self._entries) | frames(self._messages, self._fields)
            else:
                names = [name for name in self._entries if name != FRAME]
                block |= decode_entries(self._messages, self._fields, names)
                block |= frames(self._messages, self._fields) if FRAME in self._entries else {}
            block[SENT] = np.array(self._stamps_ns, np.int64)
            checksums = map(message_checksum, repeat(self._path), self._stamps_ns, self._messages)
            self._checksum = checksum_sum([self._checksum, *checksums])
        except (TypeError, ValueError, OverflowError) as error:
            # CdrError, or SQLite returns text or None instead of a number or bytes.
            raise BadInput(reason(error), self._where, f"messages of type {self._type}") from None
        self._blocks.append(block)
        self._count += len(self._messages)
        self._stamps_ns, self._messages, self._gathered = [], [], 0


def cycle_topic(topic: Topic, connections: Sequence[Connection], seal: Seal | None, where: str) -> BagTopic:
    """Return the reader of a topic of control cycles.

    Args:
        topic: the topic.
        connections: the bag's entries for it, one or more.
        seal: state of the topic when the bag was closed, if known.
        where: bag and full name of the topic, for errors.

    Raises:
        BadInput: the topic has another type in the bag, too many messages, or an unreadable definition.
    """
    fields = _fields(topic, connections[0], seal, where)
    names = {field.name for field in fields}
    wanted = {CYCLE, SECONDS, NANOSECONDS, *topic.signals} & names
    return BagTopic(connections, fields, wanted, seal, where, {} if SENDER in names else EARLIER_UNITS.get(topic.name, {}))


def _fields(topic: Topic, connection: Connection, seal: Seal | None, where: str) -> list[Field]:
    """Return the fields of a topic's messages as defined in the bag."""
    if connection.msgtype != topic.type:
        raise BadInput(f"its messages are {connection.msgtype}", where, topic.type)
    own = typestore()
    own_fields = flatten(own.fielddefs, topic.type)
    type_hash = seal.type_hash if seal else connection.digest
    if type_hash == own.hash_rihs01(topic.type):
        return own_fields
    store = typestore_of(connection.msgdef, topic.type)
    if type_hash and type_hash != store.hash_rihs01(topic.type):
        raise BadInput(f"the bag's definition of {topic.type} is missing or wrong", where, f"a type with hash {type_hash}")
    try:
        fields = flatten(store.fielddefs, topic.type)
    except CdrError as error:
        raise BadInput(str(error), where, f"{topic.type} of numbers") from None
    for field in own_fields:
        found = next((other for other in fields if other.name == field.name), None)
        if found is None and field.name not in {SENDER, *topic.signals}:
            raise BadInput(f"{topic.type} has no field {field.name} in this bag", where, "a header and a cycle")
        if found is not None and found != field:
            what = f"{topic.type} has {_kind(found)} {field.name} in this bag"
            raise BadInput(what, where, f"{_kind(field)} {field.name}")
    return fields


def _kind(field: Field) -> str:
    return field.kind + ("[]" if field.many else "")


def _values(block: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any]:
    """Return a column of a block of messages, NaN if they have no such entry."""
    return block[name] if name in block else np.full(len(block[SENT]), np.nan)


def _stacked(blocks: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Concatenate blocks of messages, padding shorter sequences with NaN."""
    longest = max(block.shape[1:] for block in blocks)
    if all(block.shape[1:] == longest for block in blocks):
        return np.concatenate(blocks)
    return np.concatenate(
        [np.pad(block, ((0, 0), (0, longest[0] - block.shape[1])), constant_values=np.nan) for block in blocks]
    )
