"""The UDP packet between this computer and a real-time target; docs/hardware.md has it as a table.

Version 1, little-endian, 64 + 8 n bytes::

    offset  size  field
         0     4  magic "EHLS"
         4     1  version, 1
         5     1  kind: 1 hello, 2 measurement, 3 command
         6     2  n, number of values: hello 0, measurement 1 to 32, command 1
         8     8  session of the sender: random, anew each time it starts, never 0
        16     8  session of the receiver as the sender knows it; 0 in a hello that knows none
        24     8  sequence number of the packet's kind, growing by 1
        32     8  measurement: sequence number of the last command taken, 0 for none;
                  command: sequence number of the measurement it answers
        40     8  sender's time [ns], signed
        48     4  command: time without a valid command after which the target goes to null [us]; otherwise 0
        52     4  measurement: why the output is at null, see Status; otherwise 0
        56   8 n  values, IEEE 754 doubles, finite
    56 + 8 n   8  CRC-32 of all bytes before (as in zlib), or with a key their BLAKE2b of 8 bytes
"""

import hashlib
import hmac
import math
import struct
import zlib
from enum import IntEnum
from typing import NamedTuple

MAGIC, VERSION = b"EHLS", 1
HEADER = struct.Struct("<4sBBHQQQQqII")
FRAME = struct.Struct("<4sBBH")
"""How the header begins."""

TAG = struct.Struct("<Q")
MOST_VALUES = 32
LARGEST = HEADER.size + 8 * MOST_VALUES + TAG.size
"""Bytes of the longest packet."""

LONGEST_KEY = hashlib.blake2b.MAX_KEY_SIZE
"""Bytes of the longest key."""

REASONS = ("length", "magic", "version", "kind", "count", "tag", "value", "session", "field")
"""Why bytes are refused, in the order in which it is looked at."""


class Kind(IntEnum):
    """What a packet is for."""

    HELLO = 1
    MEASUREMENT = 2
    COMMAND = 3


class Status(IntEnum):
    """Why the target's output is at null."""

    COMMANDED = 0
    """It is not: the last command is held."""
    WAITING = 1
    """No command came yet."""
    WATCHDOG = 2
    """None came for too long."""


class Packet(NamedTuple):
    """A packet's content; the fields are the module's table."""

    kind: int
    session: int
    peer: int
    sequence: int
    answered: int = 0
    time_ns: int = 0
    watchdog_us: int = 0
    status: int = 0
    values: tuple[float, ...] = ()


VALUES = tuple(struct.Struct(f"<{count}d") for count in range(MOST_VALUES + 1))
COUNTS: dict[int, range] = {Kind.HELLO: range(1), Kind.MEASUREMENT: range(1, MOST_VALUES + 1), Kind.COMMAND: range(1, 2)}
STATUSES: dict[int, range] = {Kind.HELLO: range(1), Kind.MEASUREMENT: range(len(Status)), Kind.COMMAND: range(1)}


class Codec:
    """Makes packets and takes them apart.

    Attributes:
        refused: number of byte strings refused, by reason.
    """

    def __init__(self, key: bytes = b"") -> None:
        """Take the key both sides share, of up to 64 bytes; empty: a CRC, which finds damage but no forger."""
        self._key = key
        self.refused = dict.fromkeys(REASONS, 0)

    def pack(self, packet: Packet) -> bytes:
        """Return a packet's bytes.

        Args:
            packet: fields that fit the table.
        """
        values = packet.values
        body = HEADER.pack(MAGIC, VERSION, packet.kind, len(values), *packet[1:8]) + VALUES[len(values)].pack(*values)
        return body + self.tag(body)

    def parse(self, data: bytes) -> Packet | None:
        """Return what bytes from the net hold, or None for anything but a whole, undamaged packet; the reason is counted."""
        packet = self._parse(data)
        if isinstance(packet, str):
            self.refused[packet] += 1
            return None
        return packet

    def _parse(self, data: bytes) -> Packet | str:
        wrong = _frame(data)
        if wrong:
            return wrong
        body = data[: -TAG.size]
        if not hmac.compare_digest(self.tag(body), data[-TAG.size :]):
            return "tag"
        _, _, kind, count, *fields = HEADER.unpack_from(data)
        packet = Packet._make((kind, *fields, VALUES[count].unpack_from(data, HEADER.size)))
        if not all(map(math.isfinite, packet.values)):
            return "value"
        if packet.session == 0:
            return "session"
        # A field that a kind does not use is 0, so that it can be used one day.
        if packet.status not in STATUSES[kind] or (packet.watchdog_us != 0) != (kind == Kind.COMMAND):
            return "field"
        return packet

    def tag(self, body: bytes) -> bytes:
        """Return the eight bytes that end a packet, for those before."""
        if self._key:
            return hashlib.blake2b(body, digest_size=TAG.size, key=self._key).digest()
        return TAG.pack(zlib.crc32(body))


def _frame(data: bytes) -> str:
    """Return the reason why bytes cannot be a packet; empty if they can."""
    if not HEADER.size + TAG.size <= len(data) <= LARGEST:
        return "length"
    magic, version, kind, count = FRAME.unpack_from(data)
    if magic != MAGIC:
        return "magic"
    if version != VERSION:
        return "version"
    if kind not in COUNTS:
        return "kind"
    if count not in COUNTS[kind] or len(data) != HEADER.size + 8 * count + TAG.size:
        return "count"
    return ""
