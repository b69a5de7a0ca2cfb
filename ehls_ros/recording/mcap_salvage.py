"""Search for messages in the remains of an mcap file.

Chunks are found by their headers, which contain the length twice, and not by walking from record to record, where one wrong
length would mislead the search. A chunk with a correct checksum is used unchanged. Elsewhere, each byte sequence in the form of
a message is tried and checked against the ledger, if the file has one.
"""

import re
import struct
from collections.abc import Iterator
from mmap import mmap
from typing import BinaryIO, NamedTuple
from zlib import crc32

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from ehls_ros.recording import limits
from ehls_ros.recording.expansion import expanded
from ehls_ros.recording.ledger import Ledger, first_match
from ehls_ros.recording.salvage import MAX_NAME, Budget, Found, Kind, Loss, Names
from ehls_ros.recording.storage_file import MCAP_CHUNK, MCAP_MESSAGE, MCAP_RECORD

CHUNK_HEAD = struct.Struct("<BQQQQII")
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
CHANNEL_HEAD = struct.Struct("<BQHHI")
SCHEMA_HEAD = struct.Struct("<BQHI")
CHUNK_REST = CHUNK_HEAD.size - MCAP_RECORD.size + 8
"""Length of an uncompressed chunk beside its records [B]."""

MAX_COMPRESSION_NAME = 8
"""Longest compression name [characters]."""

# A record's kind and a length below 16 MiB; the rest is checked in code.
_CHUNK = re.compile(rb"\x06[\s\S]{5}\x00{3}")
_MESSAGE = re.compile(rb"\x05[\s\S]{3}\x00{5}")
_SCHEMA = re.compile(rb"\x03[\s\S]{3}\x00{5}[\s\S]{2}[\s\S]{2}\x00\x00")
_TYPE = re.compile(rb"[A-Za-z0-9_]+(/[A-Za-z0-9_]+){2}\Z")
_CHANNEL = re.compile(rb"\x04[\s\S]{2}\x00{6}[\s\S]{4}([\s\S]{2})\x00\x00")


class _Chunk(NamedTuple):
    """A chunk: offsets of its start, of its records and of its end, and the checksum and compression from its header."""

    start: int
    records: int
    end: int
    checksum: int
    compressed: bool


def names_in_mcap(content: mmap) -> dict[int, str]:
    """Return the topics described in an mcap file."""
    names: dict[int, str] = {}
    offset = 0
    while (match := first_match(_CHANNEL, content, offset, len(content), CHANNEL_HEAD.size)) is not None:
        offset = match.end()
        _, length, channel, _, size = CHANNEL_HEAD.unpack_from(content, match.start())
        if size < length and size <= MAX_NAME:
            path = content[match.end() : match.end() + size]
            if path.startswith(b"/") and path.isascii():
                names.setdefault(channel, path.decode())
    return names


def kinds_in_mcap(content: mmap) -> dict[str, Kind]:
    """Return the types and definitions of the topics described in an mcap file, by the topic's full name."""
    schemas: dict[int, Kind] = {}
    offset = 0
    while (match := first_match(_SCHEMA, content, offset, len(content), SCHEMA_HEAD.size)) is not None:
        offset = match.start() + 1
        _, length, number, size = SCHEMA_HEAD.unpack_from(content, match.start())
        rest = content[match.end() : match.start() + MCAP_RECORD.size + length]
        texts = [rest[:size], *_texts(rest[size:])]
        if len(texts) == 3 and _TYPE.match(texts[0]) and texts[1] == b"ros2msg":
            definition = MessageDefinition(MessageDefinitionFormat.MSG, texts[2].decode(errors="replace"))
            schemas.setdefault(number, Kind(texts[0].decode(), definition))
            offset = match.end() + len(rest)
    kinds: dict[str, Kind] = {}
    offset = 0
    while (match := first_match(_CHANNEL, content, offset, len(content), CHANNEL_HEAD.size)) is not None:
        offset = match.end()
        _, length, _, schema, size = CHANNEL_HEAD.unpack_from(content, match.start())
        path = content[match.end() : match.end() + size] if size < min(length, MAX_NAME) else b""
        if path.startswith(b"/") and path.isascii() and schema in schemas:
            kinds.setdefault(path.decode(), schemas[schema])
    return kinds


def _texts(content: bytes) -> list[bytes]:
    """Return the texts of which the content consists, each preceded by its length; none if it does not."""
    texts, offset = list[bytes](), 0
    while offset + 4 <= len(content):
        (size,) = struct.unpack_from("<I", content, offset)
        texts.append(content[offset + 4 : offset + 4 + size])
        offset += 4 + size
    return texts if offset == len(content) else []


def expand_chunks(content: mmap, copy: BinaryIO) -> bool:
    """Write a copy of an mcap file with its compressed chunks expanded, as far as they are sound.

    Args:
        content: content of the file.
        copy: the copy.

    Returns:
        Whether a chunk was compressed; otherwise the copy is empty.
    """
    chunks, behind = list[_Chunk](), 0
    while (chunk := _next_chunk(content, behind)) is not None:
        chunks.append(chunk)
        behind = chunk.end
    compressed = [chunk for chunk in chunks if chunk.compressed]
    behind, left = 0, limits.EXPANDED + limits.EXPANSION * len(content)
    with memoryview(content) as view:
        for chunk in compressed:
            _, _, first, last, size, checksum, name = CHUNK_HEAD.unpack_from(content, chunk.start)
            compression = content[chunk.start + CHUNK_HEAD.size : chunk.start + CHUNK_HEAD.size + name].decode(errors="replace")
            data = content[chunk.records : chunk.end]
            records = expanded(compression, data, size) if size <= min(left, limits.CHUNK) else None
            if records is not None:
                left -= size
                copy.write(view[behind : chunk.start])
                copy.write(CHUNK_HEAD.pack(MCAP_CHUNK, CHUNK_REST + size, first, last, size, checksum, 0))
                copy.write(struct.pack("<Q", size) + records)
                behind = chunk.end
        copy.write(view[behind:] if compressed else b"")
    return bool(compressed)


def salvage_mcap(content: mmap, names: Names, ledger: Ledger, loss: Loss) -> Iterator[Found]:
    """Find the messages of an mcap file; see :data:`~ehls_ros.recording.salvage.Salvage`."""
    behind, budget = 0, Budget(content, loss)
    while (chunk := _next_chunk(content, behind)) is not None:
        yield from _searched(content, behind, chunk.start, names, ledger, budget)
        behind = chunk.end
        if chunk.compressed:
            loss.places.append(f"the chunk at byte {chunk.start} is compressed")
            continue
        records = content[chunk.records : chunk.end]
        if chunk.checksum and crc32(records) == chunk.checksum:
            yield from _from_sound_chunk(records, names, ledger)
        elif chunk.checksum and ledger.empty:
            loss.places.append(f"the chunk at byte {chunk.start} is damaged")
            for topic, _, _ in _messages(records, names):
                loss.count(topic)
        else:
            yield from _searched(content, chunk.records, chunk.end, names, ledger, budget)
    yield from _searched(content, behind, len(content), names, ledger, budget)


def _next_chunk(content: mmap, behind: int) -> _Chunk | None:
    while (match := first_match(_CHUNK, content, behind, len(content), MCAP_RECORD.size)) is not None:
        start = match.start()
        behind = start + 1
        if start + CHUNK_HEAD.size > len(content):
            return None
        _, length, _, _, expanded, checksum, name = CHUNK_HEAD.unpack_from(content, start)
        records = start + CHUNK_HEAD.size + name + 8
        end = start + MCAP_RECORD.size + length
        if name > MAX_COMPRESSION_NAME or end > len(content) or end < records:
            continue
        (size,) = struct.unpack_from("<Q", content, records - 8)
        if records + size == end and (name or size == expanded):
            return _Chunk(start, records, end, checksum, compressed=name > 0)
    return None


def _messages(records: bytes, names: Names) -> Iterator[tuple[str, int, bytes]]:
    """Walk from record to record, as far as the lengths are plausible."""
    offset = 0
    while offset + MCAP_RECORD.size <= len(records):
        kind, length = MCAP_RECORD.unpack_from(records, offset)
        end = offset + MCAP_RECORD.size + length
        if end > len(records):
            return
        if kind == MCAP_MESSAGE and end - offset >= MESSAGE_HEAD.size:
            _, _, channel, _, stamp_ns, _ = MESSAGE_HEAD.unpack_from(records, offset)
            yield names.get(channel, f"channel {channel}"), stamp_ns, records[offset + MESSAGE_HEAD.size : end]
        offset = end


def _from_sound_chunk(records: bytes, names: Names, ledger: Ledger) -> Iterator[Found]:
    """Return the messages of a chunk with a correct checksum."""
    messages = list(_messages(records, names))
    listed = ledger.verify(messages)
    complete = ledger.complete
    for message, known in zip(messages, listed, strict=True):
        if known or not complete:
            yield Found(*message, verified=True)


def _searched(content: mmap, start: int, end: int, names: Names, ledger: Ledger, budget: Budget) -> Iterator[Found]:
    """Try every offset in a part of the file with the form of a message."""
    while (match := first_match(_MESSAGE, content, start, end, MCAP_RECORD.size)) is not None:
        head = match.start()
        start = head + 1
        if head + MESSAGE_HEAD.size > end:
            return
        _, length, channel, _, stamp_ns, _ = MESSAGE_HEAD.unpack_from(content, head)
        behind = head + MCAP_RECORD.size + length
        if length < MESSAGE_HEAD.size - MCAP_RECORD.size or behind > end or channel not in names:
            continue
        if not budget.covers(behind - head):
            return
        message = names[channel], stamp_ns, content[head + MESSAGE_HEAD.size : behind]
        [verified] = ledger.verify([message])
        if verified or ledger.empty:
            yield Found(*message, verified)
            start = behind
