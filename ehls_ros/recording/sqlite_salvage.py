"""Search for messages in the remains of a SQLite file.

Every page is read separately, so that neither a damaged tree nor a truncated file hides the others. The rows listed by a page
are read first. Unless all of them are sound messages, each offset in the page with the form of a row is tried and checked
against the ledger, if the file has one. No code in the file is executed.
"""

import re
from collections.abc import Iterator
from mmap import mmap
from typing import NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from ehls_ros.recording.ledger import Ledger, first_match
from ehls_ros.recording.salvage import MAX_NAME, Budget, Found, Kind, Loss, Names
from ehls_ros.recording.typestore import typestore

DEFAULT_PAGE = 4096
HEADER = 100
"""Size of the file header, at the start of the first page [B]."""

MAX_ROW = 1 << 20
"""Largest row [B]; bounds the work on a damaged length."""

LEAF = 0x0D
"""Kind of a page with rows."""

WIDTHS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Size of an integer by its serial type [B]; types 8 and 9 are the constants 0 and 1."""

BLOB = 12
TEXT = 13
"""Serial types of an empty blob and an empty text; plus 2 per byte."""

# Header of a row: its size, no value for the id, two integers, and the size of the message.
_INTEGER = rb"([\x01-\x06\x08\x09])"
_VARINT = rb"([\x80-\xff]{0,4}[\x00-\x7f])"
_ROW = re.compile(rb"[\x05-\x09]\x00" + _INTEGER + _INTEGER + _VARINT)
_CELL = re.compile(rb"([\x80-\xff]{0,4}[\x00-\x7f])([\x80-\xff]{0,8}[\x00-\x7f])" + _ROW.pattern)
# A topic: its id, then name, type and the serialization format, which is a text of three letters.
_TOPIC = re.compile(
    rb"([\x01-\x7f])[\x05-\x0c]\x00" + _VARINT + _VARINT + rb"\x13[\x00-\xff]{0,6}?(/[ -~]{1,%d}cdr)" % (2 * MAX_NAME)
)
_LONGEST_TOPIC = 3 + 5 + 5 + 1 + 6 + 1 + 2 * MAX_NAME + 3


class _Row(NamedTuple):
    topic: int
    stamp_ns: int
    serialized: bytes
    ordinal: int
    end: int


def names_in_sqlite(content: mmap) -> dict[int, str]:
    """Return the topics described in a SQLite file."""
    names: dict[int, str] = {}
    offset = 0
    while (match := first_match(_TOPIC, content, offset, len(content), _LONGEST_TOPIC)) is not None:
        offset = match.end()
        size = (_varint(match[2]) - TEXT) // 2
        if 0 < size < len(match[4]):
            names.setdefault(match[1][0], match[4][:size].decode())
    return names


def kinds_in_sqlite(content: mmap) -> dict[str, Kind]:
    """Return the types of the topics described in a SQLite file, by the topic's full name; only types that are known."""
    kinds: dict[str, Kind] = {}
    offset = 0
    while (match := first_match(_TOPIC, content, offset, len(content), _LONGEST_TOPIC)) is not None:
        offset = match.end()
        name, kind = ((_varint(match[group]) - TEXT) // 2 for group in (2, 3))
        text = match[4][name : name + kind].decode()
        if 0 < name < len(match[4]) and text in typestore().fielddefs:
            kinds.setdefault(match[4][:name].decode(), Kind(text, MessageDefinition(MessageDefinitionFormat.NONE, "")))
    return kinds


def salvage_sqlite(content: mmap, names: Names, ledger: Ledger, loss: Loss) -> Iterator[Found]:
    """Find the messages of a SQLite file; see :data:`~ehls_ros.recording.salvage.Salvage`."""
    size, budget = _page_size(content), Budget(content, loss)
    for start in range(0, len(content), size):
        page = content[start : start + size]
        rows, all_rows = _rows(page, HEADER if start == 0 else 0, content, size, budget)
        messages = [(names.get(row.topic, f"topic {row.topic}"), row.stamp_ns, row.serialized) for row in rows]
        sound = ledger.verify(messages)
        for row, message, verified in zip(rows, messages, sound, strict=True):
            if verified or ledger.empty or not ledger.covers(row.ordinal):
                yield Found(*message, verified)
            else:
                loss.count(message[0])
        if not ledger.empty and not (all_rows and rows and all(sound)):
            yield from _searched(page, names, ledger, budget)


def _page_size(content: mmap) -> int:
    size = int.from_bytes(content[16:18], "big")
    size = 65536 if size == 1 else size
    return size if size in {1 << exponent for exponent in range(9, 17)} else DEFAULT_PAGE


def _rows(page: bytes, start: int, content: mmap, size: int, budget: Budget) -> tuple[list[_Row], bool]:
    """Return the messages listed by a page, and whether all its rows are messages."""
    if page[start : start + 1] != bytes([LEAF]):
        return [], False
    count = int.from_bytes(page[start + 3 : start + 5], "big")
    listed = page[start + 8 : start + 8 + 2 * count]
    cells = [int.from_bytes(listed[at : at + 2], "big") for at in range(0, len(listed), 2)]
    rows = [row for cell in cells if (row := _row(page, cell, content, size, budget)) is not None]
    return rows, len(rows) == count


def _row(page: bytes, cell: int, content: mmap, size: int, budget: Budget) -> _Row | None:
    match = _CELL.match(page, cell)
    if match is None:
        return None
    length = _varint(match[1])
    if length > MAX_ROW or not budget.covers(length):
        return None
    head = match.start(3) - 2
    here = _stored_in_page(length, size)
    payload = bytearray(page[head : head + here])
    if here < length:
        # The rest is in a linked list of overflow pages.
        following = int.from_bytes(page[head + here : head + here + 4], "big")
        while following and len(payload) < length:
            at = (following - 1) * size
            if at + 4 > len(content):
                return None
            payload += content[at + 4 : at + size]
            following = int.from_bytes(content[at : at + 4], "big")
    row = _unpacked(bytes(payload[:length]), 0)
    return row and row._replace(ordinal=_varint(match[2]) - 1)


def _stored_in_page(length: int, size: int) -> int:
    """Return the number of bytes of a row stored in its page, by SQLite's file format."""
    most, least = size - 35, (size - 12) * 32 // 255 - 23
    if length <= most:
        return length
    here = least + (length - least) % (size - 4)
    return here if here <= most else least


def _unpacked(payload: bytes, start: int) -> _Row | None:
    """Return the row that starts at an offset; None if there is none."""
    match = _ROW.match(payload, start)
    if match is None or match.end() != start + payload[start]:
        return None
    kind = _varint(match[3])
    if kind < BLOB or kind % 2:
        return None
    at = match.end()
    numbers = []
    for width in (WIDTHS[match[1][0]], WIDTHS[match[2][0]]):
        numbers.append(int.from_bytes(payload[at : at + width], "big", signed=True) if width else 0)
        at += width
    if match[1] == b"\x09":
        numbers[0] = 1
    if match[2] == b"\x09":
        numbers[1] = 1
    end = at + (kind - BLOB) // 2
    if end > len(payload) or numbers[1] < 0:
        return None
    return _Row(numbers[0], numbers[1], payload[at:end], -1, end)


def _searched(page: bytes, names: Names, ledger: Ledger, budget: Budget) -> Iterator[Found]:
    """Try every offset with the form of a row."""
    offset = 0
    while (match := _ROW.search(page, offset)) is not None:
        offset = match.start() + 1
        row = _unpacked(page, match.start())
        if row is not None and row.topic in names:
            if not budget.covers(row.end - match.start()):
                return
            message = names[row.topic], row.stamp_ns, row.serialized
            if ledger.verify([message])[0]:
                yield Found(*message, verified=True)
                offset = row.end


def _varint(content: bytes) -> int:
    number = 0
    for byte in content:
        number = number << 7 | byte & 0x7F
    return number
