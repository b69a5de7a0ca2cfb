"""Files with arrays: an uncompressed zip of a JSON document and ``.npy`` entries, also readable by :func:`numpy.load`.

The reader accepts only this: no compression, so that no file is larger in memory than on disk, no pickles, and only the types
in :data:`TYPES`.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple
from zipfile import ZIP_STORED, ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from ehls_ros.declared_arrays import Arrays

DOCUMENT = "about.json"
"""Name of the document, the first entry."""

TYPES = {"<f8": "float64", "<f4": "float32", "<c16": "complex128", "<i8": "int64"}
"""Types of arrays, by their codes in the file."""

LOCAL_HEADER = struct.Struct("<4sHHHHHIIIHH")
"""Header of an entry: mark, version, flags, method, time, date, checksum, size, size, length of name and of extra field."""

LOCAL_MARK, CENTRAL_MARK, END_MARK = b"PK\3\4", b"PK\1\2", b"PK\5\6"
"""Marks of an entry, of the directory's entries, and of the record at the end."""

END_SIZE = 22
"""Size of the record at the end [B]."""

ARRAY_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00(?P<length>..)\{'descr': '(?P<type><[a-z][0-9]+)', 'fortran_order': False, "
    rb"'shape': \((?P<shape>[0-9, ]{0,80})\), \} *\n",
    re.DOTALL,
)
"""Header of an array in C order."""

MAX_AXIS_LENGTH = 1 << 40
"""Largest length of an axis; the product of the lengths is compared with the content."""


class Damaged(ValueError):
    """The file is not such an archive, or is damaged."""


class Archive(NamedTuple):
    """The content of a file.

    Attributes:
        document: JSON text.
        arrays: arrays by name, as writable copies.
    """

    document: bytes
    arrays: dict[str, NDArray[np.generic]]


def write(file: BinaryIO, document: bytes, arrays: Arrays) -> None:
    """Write an archive.

    Args:
        file: file open for writing, at its beginning.
        document: JSON text.
        arrays: arrays by name, of the types in :data:`TYPES`.
    """
    with ZipFile(file, "w", ZIP_STORED) as archive:
        archive.writestr(ZipInfo(DOCUMENT), document)
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(array).reshape(array.shape), (1, 0), allow_pickle=False)
            archive.writestr(ZipInfo(f"{name}.npy"), content.getbuffer())


def read(content: bytes, most: int) -> Archive:
    """Read an archive.

    Args:
        content: content of the file.
        most: maximum number of arrays.

    Raises:
        Damaged: it is not such an archive, damaged, compressed, or has more arrays.
    """
    document: bytes | None = None
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, data in _entries(content):
        if document is None:
            if name != DOCUMENT:
                raise Damaged(f"it begins with {name!r}")
            document = bytes(data)
            continue
        key = name.removesuffix(".npy")
        if key in arrays:
            raise Damaged(f"it has two arrays {key!r}")
        if len(arrays) == most:
            raise Damaged(f"it has more than {most} arrays")
        arrays[key] = _array(key, data)
    if document is None:
        raise Damaged("it has no entries")
    return Archive(document, arrays)


def beginning_of_document(content: bytes) -> bytes:
    """Return the part of the document in the first bytes of a file; empty if it is not an archive."""
    if len(content) < LOCAL_HEADER.size or content[:4] != LOCAL_MARK:
        return b""
    *_, name, extra = LOCAL_HEADER.unpack_from(content)
    begin = LOCAL_HEADER.size + name + extra
    return content[begin:] if content[LOCAL_HEADER.size : begin - extra] == DOCUMENT.encode() else b""


def _entries(content: bytes) -> Iterator[tuple[str, memoryview]]:
    """Yield name and content of the entries, in the order of :func:`write`."""
    at, whole = 0, memoryview(content)
    while content[at : at + 4] == LOCAL_MARK:
        if len(content) - at < LOCAL_HEADER.size:
            raise Damaged("it is cut off")
        _, _, flags, method, _, _, checksum, packed, size, name_length, extra = LOCAL_HEADER.unpack_from(content, at)
        begin = at + LOCAL_HEADER.size + name_length + extra
        if flags or method or packed != size:
            raise Damaged("it is compressed or encrypted")
        name, data = content[at + LOCAL_HEADER.size : begin - extra], whole[begin : begin + size]
        if len(data) != size:
            raise Damaged("it is cut off")
        if zlib.crc32(data) != checksum:
            raise Damaged("its checksum is wrong")
        yield name.decode("ascii", "backslashreplace"), data
        at = begin + size
    end = content[-END_SIZE:]
    if content[at : at + 4] != CENTRAL_MARK or end[:4] != END_MARK:
        raise Damaged("it is no archive of arrays, or cut off")


def _array(name: str, data: memoryview) -> NDArray[np.generic]:
    found = ARRAY_HEADER.match(data)
    if found is None or found["type"].decode() not in TYPES:
        raise Damaged(f"the array {name!r} has another layout or type")
    shape = tuple(int(length) for length in found["shape"].replace(b" ", b"").split(b",") if length)
    kind = np.dtype(found["type"].decode())
    if any(length > MAX_AXIS_LENGTH for length in shape) or _product(shape) * kind.itemsize != len(data) - found.end():
        raise Damaged(f"the array {name!r} has another size than its header says")
    return np.frombuffer(data, kind, offset=found.end()).reshape(shape).copy()


def _product(shape: tuple[int, ...]) -> int:
    total = 1
    for length in shape:
        total *= length
    return total
