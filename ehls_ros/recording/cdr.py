"""Conversion of messages of one type to arrays and back, thousands at a time.

ROS 2 serializes messages as CDR: an encapsulation of four bytes, then the fields in order, each aligned to its size, strings
and sequences preceded by their length. Messages of one type whose strings and sequences have equal lengths share a layout, so
each field of all these messages is one slice of bytes.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict

from ehls_ros.recording.limits import LAYOUTS, MESSAGE

ENCAPSULATION = 4
LITTLE_ENDIAN = b"\x00\x01"
BYTE_ORDERS = {LITTLE_ENDIAN: "<", b"\x00\x00": ">"}
PADDING = 8
"""Bound on the excess of a message over its fields [B]: senders round up to the largest alignment."""

NUMPY_TYPES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "uint8": "u1",
    "int8": "i1",
    "uint16": "u2",
    "int16": "i2",
    "uint32": "u4",
    "int32": "i4",
    "uint64": "u8",
    "int64": "i8",
    "float32": "f4",
    "float64": "f8",
    "string": "u1",
}


class CdrError(ValueError):
    """The bytes are not a message of the given type."""


class Field(NamedTuple):
    """A field without nested fields.

    Attributes:
        name: dotted path from the message, such as ``header.stamp.sec``; in the entries of a sequence, such as
            ``transforms[].translation.x``.
        kind: ROS name of the primitive type.
        many: a sequence or an array of that type.
        length: length of an array; None for a sequence, whose length is in the message.
        parts: fields of one entry of a sequence or an array of texts or messages.
    """

    name: str
    kind: str
    many: bool
    length: int | None = None
    parts: "tuple[Field, ...]" = ()

    @property
    def width(self) -> int:
        """Size of one value, equal to its alignment [B]."""
        return int(NUMPY_TYPES[self.kind][1])


class Place(NamedTuple):
    """The values of a primitive field in a message.

    Attributes:
        field: the field.
        start: offset of the first value [B].
        length: number of values.
        within: numbers of the entries that contain it, the outermost first.
    """

    field: Field
    start: int
    length: int
    within: tuple[int, ...]

    @property
    def stop(self) -> int:
        """Offset behind the last value [B]."""
        return self.start + self.length * self.field.width


class Alike(NamedTuple):
    """Messages with the same layout.

    Attributes:
        which: their indices, shape (n,).
        rows: their bytes, shape (n, size).
        places: places of their fields, in order.
        order: their byte order, ``<`` or ``>``.
    """

    which: NDArray[np.intp]
    rows: NDArray[np.uint8]
    places: Sequence[Place]
    order: str

    def values(self, place: Place) -> NDArray[Any]:
        """Return the values at a place, shape (n, length)."""
        block = np.ascontiguousarray(self.rows[:, place.start : place.stop])
        numbers = block.view(self.order + NUMPY_TYPES[place.field.kind])
        return numbers != 0 if place.field.kind == "bool" else numbers

    def text(self, place: Place) -> str:
        """Return the text at a place in the first message."""
        return self.rows[0, place.start : place.stop].tobytes().rstrip(b"\0").decode(errors="replace")


class _Layout(NamedTuple):
    places: list[Place]
    lengths: dict[int, int]
    """Length words by their offset."""
    size: int


def flatten(types: Typesdict, message_type: str, prefix: str = "") -> list[Field]:
    """List the fields of a message type in order.

    Args:
        types: definitions by type name, such as ``Typestore.fielddefs``.
        message_type: name of the type.
        prefix: path of the enclosing field.

    Returns:
        The fields; nested ones by dotted path.

    Raises:
        CdrError: the type is undefined, or a field is of a kind that is not read, such as ``wstring``.
    """
    if message_type not in types:
        raise CdrError(f"type {message_type} is not defined")
    fields: list[Field] = []
    for name, description in types[message_type][1]:
        path = prefix + name
        match description:
            case (Nodetype.NAME, str(nested)):
                fields += flatten(types, nested, f"{path}.")
            case (Nodetype.BASE, (str(kind), _)) if kind in NUMPY_TYPES:
                fields.append(Field(path, kind, many=False))
            case (Nodetype.SEQUENCE | Nodetype.ARRAY as several, ((Nodetype.BASE, (str(kind), _)), size)) if (
                kind in NUMPY_TYPES
            ):
                parts: tuple[Field, ...] = (Field(f"{path}[]", kind, many=False),) if kind == "string" else ()
                fields.append(Field(path, kind, True, size if several is Nodetype.ARRAY else None, parts))
            case (Nodetype.SEQUENCE | Nodetype.ARRAY as several, ((Nodetype.NAME, str(nested)), size)):
                parts = tuple(flatten(types, nested, f"{path}[]."))
                fields.append(Field(path, "string", True, size if several is Nodetype.ARRAY else None, parts))
            case _:
                raise CdrError(f"field {path} of {message_type} is of a kind that is not read")
    return fields


def decode(messages: Sequence[bytes], fields: Sequence[Field], wanted: Collection[str]) -> dict[str, NDArray[Any]]:
    """Convert messages to one array per field.

    Args:
        messages: n serialized messages of one type.
        fields: the fields of that type, from :func:`flatten`.
        wanted: names of the fields to return, none of them a string.

    Returns:
        Arrays of shape (n,) in the type of the field, by name; for a sequence, floats of shape (n, longest), padded with NaN.

    Raises:
        CdrError: a message is truncated, too long, or not plain CDR, or the lengths of strings and sequences vary too much.
    """
    parts = [
        (alike.which, {place.field.name: alike.values(place) for place in alike.places if place.field.name in wanted})
        for alike in by_layout(messages, fields)
    ]
    arrays: dict[str, NDArray[Any]] = {}
    for field in fields:
        if field.name not in wanted:
            continue
        pieces = [(which, values[field.name]) for which, values in parts]
        if field.many:
            longest = max((piece.shape[1] for _, piece in pieces), default=0)
            column = np.full((len(messages), longest), np.nan)
            for which, piece in pieces:
                column[which, : piece.shape[1]] = piece
        else:
            column = np.empty(len(messages), NUMPY_TYPES[field.kind])
            for which, piece in pieces:
                column[which] = piece[:, 0]
        arrays[field.name] = column
    return arrays


def encode(fields: Sequence[Field], values: Mapping[str, NDArray[Any] | str]) -> list[bytes]:
    """Serialize n messages of one type.

    Args:
        fields: the fields of that type, from :func:`flatten`.
        values: for every field an array of shape (n,), for a sequence (n, length), for a string one text.

    Returns:
        The serialized messages.
    """
    encoded = {name: _encode_values(value) for name, value in values.items()}
    count = max(len(value) for value in values.values() if not isinstance(value, str))
    layout = _layout(fields, lambda field, _: encoded[field.name].shape[1])
    rows = np.zeros((count, layout.size), np.uint8)
    rows[:, : len(LITTLE_ENDIAN)] = np.frombuffer(LITTLE_ENDIAN, np.uint8)
    for offset, length in layout.lengths.items():
        rows[:, offset : offset + 4] = np.frombuffer(length.to_bytes(4, "little"), np.uint8)
    for field, start, length, _ in layout.places:
        numbers = np.ascontiguousarray(encoded[field.name], "<" + NUMPY_TYPES[field.kind])
        rows[:, start : start + length * field.width] = numbers.view(np.uint8)
    blob = rows.tobytes()
    return [blob[start : start + layout.size] for start in range(0, len(blob), layout.size)]


def _encode_values(values: NDArray[Any] | str) -> NDArray[Any]:
    if isinstance(values, str):
        return np.frombuffer(values.encode() + b"\0", np.uint8)[np.newaxis]
    return values if values.ndim > 1 else values[:, np.newaxis]


def _by_size(messages: Sequence[bytes]) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.intp]]]:
    """Yield the messages of each size as rows of bytes, with their indices."""
    sizes = np.fromiter(map(len, messages), np.intp, len(messages))
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        joined = b"".join(messages if len(which) == len(messages) else [messages[index] for index in which.tolist()])
        yield np.frombuffer(joined, np.uint8).reshape(len(which), size), which


def by_layout(messages: Sequence[bytes], fields: Sequence[Field], texts: Collection[str] = ()) -> Iterator[Alike]:
    """Group messages of one type by their layout.

    Args:
        messages: n serialized messages.
        fields: the fields of that type, from :func:`flatten`.
        texts: names of texts that are equal within a group.

    Raises:
        CdrError: as of :func:`decode`; or the texts vary too much.
    """
    groups = 0
    for rows, which in _by_size(messages):
        for alike in _of_one_size(rows, which, fields, texts):
            groups += 1
            if groups > LAYOUTS:
                labels = ", or labels," if texts else ""
                raise CdrError(f"messages have strings and sequences of more than {LAYOUTS} different lengths{labels}")
            yield alike


def _of_one_size(
    rows: NDArray[np.uint8], which: NDArray[np.intp], fields: Sequence[Field], texts: Collection[str]
) -> Iterator[Alike]:
    while len(rows):
        first = rows[0].tobytes()
        order = BYTE_ORDERS.get(first[:2])
        if order is None:
            raise CdrError(f"message starts with {first[:ENCAPSULATION].hex() or 'nothing'}, which is not plain CDR")
        layout = _layout(fields, partial(_length_at, first, order))
        if not layout.size <= len(first) < layout.size + PADDING:
            raise CdrError(f"message has {len(first)} bytes where its fields need {layout.size}")
        alike = (rows[:, :2] == rows[0, :2]).all(axis=1)
        for offset in layout.lengths:
            alike &= (rows[:, offset : offset + 4] == rows[0, offset : offset + 4]).all(axis=1)
        for place in layout.places:
            if place.field.name in texts:
                alike &= (rows[:, place.start : place.stop] == rows[0, place.start : place.stop]).all(axis=1)
        yield Alike(which[alike], rows[alike], layout.places, order)
        rows, which = rows[~alike], which[~alike]


def _length_at(message: bytes, order: str, _: Field, offset: int) -> int:
    word = message[offset : offset + 4]
    if len(word) < 4:
        raise CdrError(f"message is truncated after {len(message)} bytes")
    return int.from_bytes(word, "little" if order == "<" else "big")


def _layout(fields: Sequence[Field], length_at: Callable[[Field, int], int]) -> _Layout:
    """Place the fields; ``length_at`` returns a string's or sequence's length from its field and its length word's offset."""
    places: list[Place] = []
    lengths: dict[int, int] = {}

    def placed(fields: Sequence[Field], end: int, index: tuple[int, ...]) -> int:
        """Place the fields of an entry from an offset on; return the end offset."""
        for field in fields:
            length = 1 if field.length is None else field.length
            if field.length is None and (field.many or field.kind == "string"):
                end = _aligned(end, 4)
                lengths[end] = length = length_at(field, end)
                end += 4
            if field.parts:
                for number in range(length):
                    begin, end = end, placed(field.parts, end, (*index, number))
                    # The number of empty entries is not bounded by the size.
                    if end > MESSAGE or end == begin:
                        raise CdrError(f"field {field.name} has {length} entries, which no message of {MESSAGE} bytes holds")
                continue
            # No alignment follows an empty sequence.
            places.append(Place(field, _aligned(end, field.width) if length else end, length, index))
            end = places[-1].stop
        return end

    return _Layout(places, lengths, placed(fields, ENCAPSULATION, ()))


def _aligned(offset: int, width: int) -> int:
    """Round up to the next multiple of the width, counted from the end of the encapsulation."""
    return offset + (ENCAPSULATION - offset) % width
