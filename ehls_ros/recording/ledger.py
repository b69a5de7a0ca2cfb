"""The ledger in a bag's storage file: a list of the messages written, with a checksum for each.

rosbag2 has no message checksums, and its files are readable only while their structure is intact. The blocks of the ledger are
spread between the messages; each starts with a mark and fits a page of SQLite, so that it can be found in any fragment of a
file. A message that matches an entry is unaltered, regardless of its place; an entry without a message is a loss.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from mmap import mmap
from struct import Struct
from typing import Annotated, Any, NamedTuple, cast
from zlib import compress, decompressobj
from zlib import error as CompressionError  # noqa: N812 - an exception, and zlib has no better name for it

import numpy as np
from numpy.typing import NDArray

from ehls_ros.recording.provenance import checksum_of, checksum_sum, message_checksum, message_digest
from ehls_ros.schema import from_json, quantity

PIECE = 1 << 20
"""Bytes searched in one call."""


MAX_PARTS = 255
"""Maximum number of blocks of a bag's provenance."""

MARK = b"\x9dLEDGER\x1a"

_MARK = re.compile(re.escape(MARK))

ROOM = 4000
"""Maximum size of a block [B]: fits a SQLite page of 4096 B with its overhead."""

MAX_HEAD, MAX_TEXT = 1 << 17, 1 << 24
"""Maximum expanded sizes of the head of a block and of a bag's provenance [B]."""

ENTRY = Struct("<BQ8s")

ENTRIES = np.dtype([("topic", "u1"), ("stamp_ns", "<u8"), ("checksum", "<u8")])

MESSAGES, PROVENANCE = 0, 1

_Number = Annotated[int, quantity("1", "number of a topic or of messages", minimum=0, maximum=1 << 53)]

_FRAME = Struct("<8sQBHH")

_FRAMED = Struct("<BHH")


def first_match(
    pattern: re.Pattern[bytes], content: bytes | mmap, start: int, end: int, longest: int
) -> re.Match[bytes] | None:
    """Return the first match of a pattern, searching in pieces so that Ctrl-C is handled.

    Args:
        pattern: the pattern.
        content: content of the file.
        start: offset to begin at.
        end: offset behind the last byte that may belong to the match.
        longest: length of the longest match.
    """
    for begin in range(start, end, PIECE):
        match = pattern.search(content, begin, min(begin + PIECE + longest, end))
        if match is not None:
            return match
    return None


class Tally(NamedTuple):
    """Summary of the messages written on one topic.

    Attributes:
        messages: number of messages.
        checksum: :func:`~ehls_ros.recording.provenance.checksum_sum` of them.
        newest_ns: latest time of sending [ns].
    """

    messages: int
    checksum: int
    newest_ns: int


class LedgerWriter:
    """Builds the ledger of a file being written; the storage writes the blocks."""

    def __init__(self) -> None:
        """Start without topics."""
        self._paths: dict[int, str] = {}
        self._tallies: dict[int, Tally] = {}
        self._full: list[bytes] = []
        self._entries = bytearray()
        self._head = b""
        self._room = 0

    def add_topic(self, topic: int, path: str) -> None:
        """Add a topic before its first message.

        Args:
            topic: its number in the file, at most 255.
            path: its full name.
        """
        self._close_block()
        self._paths[topic] = path
        self._tallies[topic] = Tally(0, 0, 0)
        self._begin_block()

    def add(self, topic: int, stamp_ns: int, serialized: bytes | memoryview) -> None:
        """Enter a message.

        Args:
            topic: number of its topic.
            stamp_ns: time of sending [ns].
            serialized: the message as CDR.
        """
        if len(self._entries) >= self._room:
            self._close_block()
        self._entries += ENTRY.pack(topic, stamp_ns, message_digest(self._paths[topic], stamp_ns, serialized))

    def take(self) -> list[bytes]:
        """Return the blocks of the messages entered since the last call."""
        self._close_block()
        blocks, self._full = self._full, []
        return blocks

    def tallies(self) -> dict[str, Tally]:
        """Return the tallies by the topic's full name."""
        self._close_block()
        return {self._paths[topic]: tally for topic, tally in self._tallies.items()}

    def _close_block(self) -> None:
        if not self._entries:
            return
        entries = np.frombuffer(bytes(self._entries), ENTRIES)
        self._full.append(_block(MESSAGES, len(entries), self._head, entries.tobytes()))
        self._entries.clear()
        for topic in np.flatnonzero(np.bincount(entries["topic"])).tolist():
            chosen = entries[entries["topic"] == topic]
            tally = self._tallies[topic]
            self._tallies[topic] = Tally(
                tally.messages + len(chosen),
                checksum_sum([tally.checksum, int(chosen["checksum"].sum())]),
                max(tally.newest_ns, int(chosen["stamp_ns"].max())),
            )
        self._begin_block()

    def _begin_block(self) -> None:
        before = {path: [topic, self._tallies[topic].messages] for topic, path in self._paths.items()}
        self._head = compress(json.dumps(before).encode(), 1)
        self._room = (ROOM - _FRAME.size - len(self._head)) // ENTRY.size * ENTRY.size


def provenance_blocks(text: str) -> list[bytes]:
    """Return the blocks that hold a bag's provenance; none if it is too long.

    Args:
        text: provenance as read by :func:`~ehls_ros.recording.provenance.provenance_in`.
    """
    packed = compress(text.encode(), 9)
    size = ROOM - _FRAME.size
    parts = [packed[start : start + size] for start in range(0, len(packed), size)]
    if len(parts) > MAX_PARTS:
        return []
    blocks = [_block(PROVENANCE, len(parts) << 8 | number, part, b"") for number, part in enumerate(parts)]
    return 2 * blocks  # twice, in case a block is damaged


def _block(kind: int, count: int, head: bytes, rest: bytes) -> bytes:
    content = _FRAMED.pack(kind, count, len(head)) + head + rest
    return MARK + checksum_of(content).to_bytes(8, "little") + content


class Range(NamedTuple):
    """A gap: consecutive messages of one topic that are lost.

    Attributes:
        messages: number of messages.
        first_ns: time of sending of the first [ns].
        last_ns: time of sending of the last [ns].
    """

    messages: int
    first_ns: int
    last_ns: int


class _Block(NamedTuple):
    """A block found in a file.

    ``sound``: whether its checksum is correct. ``number`` counts the entries; for provenance it packs the number of blocks and
    this one's index.
    """

    sound: bool
    checksum: int
    kind: int
    number: int
    head: bytes
    rest: bytes


def _blocks_in(content: bytes | mmap) -> Iterator[_Block]:
    offset = 0
    while (match := first_match(_MARK, content, offset, len(content), len(MARK))) is not None:
        offset = match.end()
        block = content[match.start() : match.start() + ROOM]
        if len(block) < _FRAME.size:
            continue
        _, checksum, kind, count, length = _FRAME.unpack_from(block)
        size = length + (count * ENTRY.size if kind == MESSAGES else 0)
        sound = checksum_of(block[_FRAME.size - _FRAMED.size : _FRAME.size + size]) == checksum
        body = block[_FRAME.size :]
        yield _Block(sound, checksum, kind, count, body[:length], body[length:])


class Ledger:
    """Ledger of a file, as far as its blocks survive; it also tracks the messages found."""

    def __init__(self, content: bytes | mmap) -> None:
        """Find the blocks.

        Args:
            content: content of the storage file.
        """
        self.names: dict[int, str] = {}
        """Full names of the topics by their number in the file."""
        self.counts: dict[str, int] = {}
        """Number of messages written, by the topic's full name, according to the sound blocks."""
        self.damaged_blocks = 0
        spans: list[tuple[int, int]] = []
        entries: list[NDArray[Any]] = []
        sound: list[NDArray[np.bool_]] = []
        parts: dict[tuple[int, int], bytes] = {}
        seen: set[int] = set()
        for block in _blocks_in(content):
            if block.sound and block.checksum in seen:
                continue
            seen.add(block.checksum)
            before = _parsed_head(block.head) if block.sound and block.kind == MESSAGES else {}
            usable = block.sound and before is not None
            self.damaged_blocks += not usable
            if usable and block.kind == PROVENANCE:
                parts[block.number >> 8, block.number & 0xFF] = block.head
            if block.kind == MESSAGES and block.rest:
                listed = np.frombuffer(block.rest[: len(block.rest) // ENTRY.size * ENTRY.size], ENTRIES)[: block.number]
                entries.append(listed)
                sound.append(np.full(len(listed), usable))
                if before:
                    self._learn(before, listed)
                    first = sum(messages for _, messages in before.values())
                    spans.append((first, first + len(listed)))
        self.provenance = _joined(parts)
        """Text of :func:`provenance_blocks`; None if it is incomplete."""
        self._spans = np.array(sorted(spans), np.int64).reshape(-1, 2)
        listed = np.concatenate([np.zeros(0, ENTRIES), *entries])
        order = np.argsort(listed["checksum"], kind="stable")
        self._entries = listed[order]
        self._sound = np.concatenate([np.zeros(0, np.bool_), *sound])[order]
        self._checksums, self._starts, self._numbers = np.unique(
            self._entries["checksum"], return_index=True, return_counts=True
        )
        self._left = self._numbers.copy()

    @property
    def empty(self) -> bool:
        """Whether the file has no entry for any message."""
        return not len(self._entries)

    @property
    def complete(self) -> bool:
        """Whether no block is missing between the first and the last, so that a message without an entry was never written."""
        ends = np.concatenate(([0], self._spans[:, 1]))
        return not self.empty and not self.damaged_blocks and bool((self._spans[:, 0] == ends[:-1]).all())

    def verify(self, messages: Sequence[tuple[str, int, bytes]]) -> list[bool]:
        """Return for each message whether it is unaltered; each entry matches only once.

        Args:
            messages: full name of the topic, time of sending [ns], and the message as CDR.
        """
        if self.empty:
            return [False] * len(messages)
        checksums = np.array([message_checksum(*message) for message in messages], np.uint64)
        places = np.minimum(np.searchsorted(self._checksums, checksums), len(self._checksums) - 1)
        found: list[bool] = []
        for place, known in zip(places.tolist(), (self._checksums[places] == checksums).tolist(), strict=True):
            found.append(known and self._left[place] > 0)
            self._left[place] -= found[-1]
        return found

    def covers(self, ordinal: int) -> bool:
        """Return whether a sound block lists the message with a number, counted from 0 over all topics."""
        place = int(np.searchsorted(self._spans[:, 0], ordinal, side="right")) - 1
        return place >= 0 and ordinal < self._spans[place, 1]

    def lost(self) -> dict[str, list[Range]]:
        """Return the messages listed by sound blocks but not found, by the topic's full name."""
        within = np.arange(len(self._entries)) - np.repeat(self._starts, self._numbers)
        missing = within >= np.repeat(self._numbers - self._left, self._numbers)
        ranges: dict[str, list[Range]] = {}
        for number, path in self.names.items():
            chosen = self._sound & (self._entries["topic"] == number)
            order = np.argsort(self._entries["stamp_ns"][chosen], kind="stable")
            stamps, lost = self._entries["stamp_ns"][chosen][order], missing[chosen][order]
            edges = np.flatnonzero(np.diff(np.concatenate(([False], lost, [False])).astype(np.int8)))
            runs = [
                Range(last - first, int(stamps[first]), int(stamps[last - 1])) for first, last in edges.reshape(-1, 2).tolist()
            ]
            if runs:
                ranges[path] = runs
        return ranges

    def _learn(self, before: Mapping[str, tuple[int, int]], listed: NDArray[Any]) -> None:
        """Update names and counts from a sound block."""
        for path, (number, messages) in before.items():
            self.names[number] = path
            here = int(np.count_nonzero(listed["topic"] == number))
            self.counts[path] = max(self.counts.get(path, 0), messages + here)


def _parsed_head(head: bytes) -> Mapping[str, tuple[int, int]] | None:
    """Return each topic's number and the count of its earlier messages, by full name, from the head of a block."""
    try:
        text = _expanded(head, MAX_HEAD)
        return cast(Mapping[str, tuple[int, int]], from_json(Mapping[str, tuple[_Number, _Number]], text))
    except (CompressionError, ValueError):
        return None


def _joined(parts: Mapping[tuple[int, int], bytes]) -> str | None:
    total = next((total for total, _ in parts), 0)
    if not total or len(parts) < total:
        return None
    try:
        return _expanded(b"".join(part for _, part in sorted(parts.items())), MAX_TEXT).decode()
    except (CompressionError, UnicodeDecodeError):
        return None


def _expanded(packed: bytes, longest: int) -> bytes:
    return decompressobj().decompress(packed, longest)
