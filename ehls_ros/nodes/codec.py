"""Conversion of control-path messages to and from CDR with one ``struct`` call.

rclpy fills a message object field by field, 8-14 us each way; at thousands of messages per second and node,
that is most of the work. All control-path messages consist of a header, numbers and possibly sequences: a fixed
layout for a given frame name and given lengths of the sequences.
"""

import struct
from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import Any

NANOSECONDS = 1_000_000_000

_NUMBERS = {"double": ("d", 8), "uint64": ("Q", 8), "uint32": ("I", 4), "uint8": ("B", 1), "boolean": ("?", 1)}
_ENCAPSULATION = 4
_FRAME_LENGTH_AT = _ENCAPSULATION + 8


class _Layout:
    """A ``struct`` format built field by field with CDR alignment."""

    def __init__(self, frame_length: int) -> None:
        self.format = f"4siII{frame_length}s"
        self._size = 8 + 4 + frame_length

    def add(self, kind: str, size: int, count: int = 1) -> None:
        gap = -self._size % size
        self.format += f"{gap}x{count}{kind}"
        self._size += gap + count * size


def _leading_numbers(fields: Mapping[str, str]) -> list[str]:
    """Return the names of the numeric fields between the header and the first sequence."""
    names = []
    for name, kind in fields.items():
        if name == "header":
            continue
        if kind not in _NUMBERS:
            break
        names.append(name)
    return names


def decode_text(message: bytes) -> str | None:
    """Return the text of a ``std_msgs/String``; None if the bytes are not one."""
    order = "<" if message[1:2] == b"\1" else ">"
    try:
        (length,) = struct.unpack_from(f"{order}I", message, _ENCAPSULATION)
    except struct.error:
        return None
    text = message[_ENCAPSULATION + 4 : _ENCAPSULATION + 4 + length]
    return text.rstrip(b"\0").decode(errors="replace") if len(text) == length else None


def decode_flag(message: bytes) -> bool | None:
    """Return the value of a ``std_msgs/Bool``; None if the bytes are not one."""
    return bool(message[_ENCAPSULATION]) if len(message) > _ENCAPSULATION else None


class Encoder:
    """Encodes one message type."""

    def __init__(self, message: Any, frame_id: str = "", lengths: Mapping[str, int] | None = None, sender: str = "") -> None:
        """Fix the layout.

        Args:
            message: message class; its first field is the header.
            frame_id: frame name in the header.
            lengths: length of each sequence field.
            sender: content of the text field, if there is one.
        """
        self._frame = frame_id.encode() + b"\0"
        self._sender: tuple[Any, ...] = ()
        self._before_sender = 0
        layout = _Layout(len(self._frame))
        for name, kind in message.get_fields_and_field_types().items():
            if name == "header":
                continue
            if kind in _NUMBERS:
                layout.add(*_NUMBERS[kind])
                self._before_sender += not self._sender
            elif kind == "string":
                text = sender.encode() + b"\0"
                self._sender = (len(text), text)
                layout.add("I", 4)
                layout.add("s", 1, count=len(text))
            else:
                layout.add("I", 4)
                element = kind.removeprefix("sequence<").removesuffix(">")
                layout.add(*_NUMBERS[element], count=(lengths or {})[name])
        self._pack = struct.Struct("<" + layout.format).pack

    def __call__(self, stamp_ns: int, *values: float) -> bytes:
        """Return the serialised message.

        Args:
            stamp_ns: the header's stamp [ns].
            values: the numeric fields in order; for a sequence, its length and then its elements.
        """
        frame, stamp, n = self._frame, divmod(stamp_ns, NANOSECONDS), self._before_sender
        return self._pack(b"\0\1\0\0", *stamp, len(frame), frame, *values[:n], *self._sender, *values[n:])


class Template:
    """A message serialised once, of which only the stamp and some numbers change."""

    def __init__(self, serialised: bytes, marks: Sequence[float], *, stamped: bool) -> None:
        """Locate the numbers in the serialised example.

        Args:
            serialised: an example, little endian.
            marks: the numbers in the example that are to change, each occurring only once.
            stamped: whether it begins with a header.
        """
        self._bytes = bytearray(serialised)
        self._stamped = stamped
        self._places = [serialised.index(struct.pack("<d", mark)) for mark in marks]

    def __call__(self, stamp_ns: int, values: Sequence[float]) -> bytes:
        """Return the message with a stamp [ns] and numbers, in the order of the marks."""
        if self._stamped:
            struct.pack_into("<iI", self._bytes, _ENCAPSULATION, *divmod(stamp_ns, NANOSECONDS))
        for place, value in zip(self._places, values, strict=True):
            struct.pack_into("<d", self._bytes, place, value)
        return bytes(self._bytes)


class Decoder:
    """Decodes the leading numbers of one message type, with any frame name, and the texts after them, such as the sender.

    Messages name their sender since rclpy does not give the publisher of a message.

    Attributes:
        texts: number of texts.
    """

    MOST_FORMATS = 64
    """Layouts cached, one per length of frame name; the senders of a graph use few."""

    def __init__(self, message: Any) -> None:
        """Read the message type.

        Args:
            message: message class.
        """
        fields = message.get_fields_and_field_types()
        numbers = _leading_numbers(fields)
        following = [kind for name, kind in fields.items() if name != "header"][len(numbers) :]
        self.texts = len(list(takewhile("string".__eq__, following)))
        self._kinds = [_NUMBERS[fields[name]] for name in numbers]
        self._formats: dict[tuple[int, bytes], struct.Struct] = {}

    def __call__(self, message: bytes) -> tuple[Any, ...] | None:
        """Return the header's stamp [ns], the numbers and the texts; None for other bytes."""
        order = b"<" if message[1:2] == b"\1" else b">"
        try:
            (frame_length,) = struct.unpack_from(order.decode() + "I", message, _FRAME_LENGTH_AT)
            known = self._formats.get((frame_length, order))
            if known is None:
                if frame_length > len(message):
                    return None
                known = self._format(frame_length, order)
            _, seconds, nanoseconds, _, _, *fields = known.unpack_from(message)
            end = known.size
            for text in range(self.texts):
                if text > 0:
                    begin = end + -(end - _ENCAPSULATION) % 4
                    fields.append(struct.unpack_from(order.decode() + "I", message, begin)[0])
                    end = begin + 4
                begin, end = end, end + fields[-1]
                if end > len(message):
                    return None
                fields[-1] = message[begin:end].rstrip(b"\0").decode(errors="replace")
        except struct.error:
            return None
        return (seconds * NANOSECONDS + nanoseconds, *fields)

    def _format(self, frame_length: int, order: bytes) -> struct.Struct:
        layout = _Layout(frame_length)
        for kind, size in self._kinds:
            layout.add(kind, size)
        if self.texts:
            # The length of the first one.
            layout.add("I", 4)
        if len(self._formats) >= self.MOST_FORMATS:
            self._formats.clear()
        made = struct.Struct(order.decode() + layout.format)
        self._formats[frame_length, order] = made
        return made
