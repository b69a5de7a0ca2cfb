"""The UDP packet between this computer and a real-time target; also a table in docs/hardware.md.

Version 1, little-endian, 64 + 8 n bytes::

    offset  size  field
         0     4  magic "EHLS"
         4     1  version, 1
         5     1  kind: 1 hello, 2 measurement, 3 command
         6     2  n, number of values: hello 0, measurement 1 to 32, command 1
         8     8  session of the sender: random, anew each time it starts, never 0
        16     8  session of the receiver as the sender knows it; 0 in a hello that knows none
        24     8  sequence number, counted per kind, increasing by 1
        32     8  measurement: sequence number of the last command accepted, 0 for none;
                  command: sequence number of the measurement it answers
        40     8  sender's time [ns], signed
        48     4  command: time without a valid command after which the target goes to null, 1 to 1e6 us; otherwise 0
        52     4  measurement: why the output is at null, see Status; otherwise 0
        56   8 n  values, IEEE 754 doubles, finite
    56 + 8 n   8  tag of all preceding bytes: CRC-32 (as in zlib) or, with a key, keyed BLAKE2b of 8 bytes
"""

import hashlib
import hmac
import math
import secrets
import struct
import zlib
from enum import IntEnum
from typing import NamedTuple

MAGIC, VERSION = b"EHLS", 1
HEADER = struct.Struct("<4sBBHQQQQqII")
FRAME = struct.Struct("<4sBBH")
"""Start of the header."""

TAG = struct.Struct("<Q")
MAX_VALUES = 32
MAX_SIZE = HEADER.size + 8 * MAX_VALUES + TAG.size
"""Length of the longest packet [B]."""

MAX_AT_ONCE = 256
"""Maximum number of packets received at once, so that a flood cannot block a loop."""

MAX_KEY = hashlib.blake2b.MAX_KEY_SIZE
"""Length of the longest key [B]."""

REASONS = ("length", "magic", "version", "kind", "count", "tag", "value", "session", "field")
"""Reasons for refusing a datagram, in the order of the checks."""


class Kind(IntEnum):
    """Kind of packet."""

    HELLO = 1
    MEASUREMENT = 2
    COMMAND = 3


class Status(IntEnum):
    """Reason why the target's output is at null."""

    COMMANDED = 0
    """Not at null: the last command is held."""
    WAITING = 1
    """No command yet."""
    WATCHDOG = 2
    """No command for longer than the watchdog time."""


class Packet(NamedTuple):
    """Content of a packet; the module's docstring describes the fields."""

    kind: int
    session: int
    peer: int
    sequence: int
    answered: int = 0
    time_ns: int = 0
    watchdog_us: int = 0
    status: int = 0
    values: tuple[float, ...] = ()


VALUES = tuple(struct.Struct(f"<{count}d") for count in range(MAX_VALUES + 1))
COUNTS: dict[int, range] = {Kind.HELLO: range(1), Kind.MEASUREMENT: range(1, MAX_VALUES + 1), Kind.COMMAND: range(1, 2)}
MAX_WATCHDOG_US = 1_000_000
WATCHDOGS: dict[int, range] = {
    Kind.HELLO: range(1), Kind.MEASUREMENT: range(1), Kind.COMMAND: range(1, MAX_WATCHDOG_US + 1),
}  # fmt: skip
STATUSES: dict[int, range] = {Kind.HELLO: range(1), Kind.MEASUREMENT: range(len(Status)), Kind.COMMAND: range(1)}


def random_session() -> int:
    """Draw a session number, never 0."""
    return secrets.randbits(64) | 1


class Codec:
    """Packs and parses packets.

    Attributes:
        refused: number of datagrams refused, by reason.
    """

    def __init__(self, key: bytes = b"") -> None:
        """Set the shared key, up to 64 bytes; empty: a CRC, which detects damage but not forgery."""
        self._key = key
        self.refused = dict.fromkeys(REASONS, 0)

    def figures(self) -> dict[str, int]:
        """Return the counts of refused datagrams, named for diagnostics."""
        return {f"refused_{reason}": count for reason, count in self.refused.items()}

    def pack(self, packet: Packet) -> bytes:
        """Return a packet's bytes."""
        values = packet.values
        body = HEADER.pack(MAGIC, VERSION, packet.kind, len(values), *packet[1:8]) + VALUES[len(values)].pack(*values)
        return body + self.tag(body)

    def parse(self, data: bytes) -> Packet | None:
        """Return the packet in a datagram; None, with the reason counted, unless it is complete and undamaged."""
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
        # Unused fields must be 0, so that a later version can use them.
        if packet.status not in STATUSES[kind] or packet.watchdog_us not in WATCHDOGS[kind]:
            return "field"
        return packet

    def tag(self, body: bytes) -> bytes:
        """Return the eight bytes that end a packet, computed from the preceding ones."""
        if self._key:
            return hashlib.blake2b(body, digest_size=TAG.size, key=self._key).digest()
        return TAG.pack(zlib.crc32(body))


def _frame(data: bytes) -> str:
    """Return why the length or the start of the header cannot be a packet's; empty if they can."""
    if not HEADER.size + TAG.size <= len(data) <= MAX_SIZE:
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
