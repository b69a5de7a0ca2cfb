"""Bounded decompression of bags.

A few bytes of zstd or LZ4 can expand to gigabytes, and an index can list one chunk a million times; rosbags follows both. So
the chunks of an mcap file are checked before rosbags opens it, and compressed messages and files are expanded here. All
expanded bytes count against one allowance, a multiple of the bag's size on disk.
"""

import struct
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple

import lz4.frame

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.limits import EXPANDED, EXPANSION, Deadline
from ehls_ros.recording.storage_file import (
    CLOSED_BAG,
    MCAP_CHUNK,
    MCAP_CHUNK_INDEX,
    MCAP_FOOTER,
    MCAP_MAGIC,
    MCAP_RECORD,
)

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

PIECE = 1 << 20
"""Bytes expanded at a time."""

STREAMS: Mapping[str, Callable[[BinaryIO], Any]] = {"zstd": zstd.open, "lz4": lz4.frame.open}
"""Readers by compression name."""

FRAME = b"\x28\xb5\x2f\xfd"
"""Magic number of a zstd frame."""

MCAP_SKIPPED = (0x09, 0x0C)
"""Attachments and metadata, whose content rosbags skips."""

CHUNK_HEAD = struct.Struct("<QQQII")
INDEX_HEAD = struct.Struct("<QQQQI")


class Allowance:
    """Number of bytes to which a bag may still expand."""

    def __init__(self, size: int) -> None:
        """Start with the full allowance.

        Args:
            size: size of the bag on disk [B].
        """
        self._size = size
        self.left = EXPANDED + EXPANSION * size

    def spend(self, count: int, where: str) -> None:
        """Deduct expanded bytes.

        Args:
            count: number of bytes.
            where: source of the bytes, for the error.

        Raises:
            BadInput: the allowance is exceeded.
        """
        self.left -= count
        if self.left < 0:
            what = f"its {self._size} bytes expand to more than {EXPANDED + EXPANSION * self._size}"
            expected = f"compression of at most {EXPANSION}:1, or none: `ros2 bag convert` writes such a bag"
            raise BadInput(what, where, expected)


class _Chunk(NamedTuple):
    """Description of a chunk in its header and in the index; sizes in bytes."""

    compression: str
    compressed: int
    expanded: int


def check_chunks(file: Path, allowance: Allowance, deadline: Deadline) -> None:
    """Check the expanded sizes of an mcap file's chunks, and that the index lists each of them at most once.

    Args:
        file: file with an intact end, as checked by :func:`~ehls_ros.recording.storage_file.custom_data_in`.
        allowance: allowance of the bag.
        deadline: deadline of the reading.

    Raises:
        BadInput: a chunk expands to another size than stated, or beyond the allowance; the index does not match the chunks; or
            rosbags would have to hold too many chunks at once.
        OSError: the file cannot be read.
        ValueError: a record is invalid.
        struct.error: a record is invalid.
    """
    with file.open("rb") as stream:
        footer = stream.seek(-MCAP_FOOTER.size, 2)
        summary = MCAP_FOOTER.unpack(stream.read())[2] or footer
        chunks = {}
        for kind, start, length in _records(stream, len(MCAP_MAGIC), summary):
            deadline.check()
            where = f"{file}, byte {start}"
            if length > (limits.CHUNK if kind == MCAP_CHUNK else limits.SUMMARY) and kind not in MCAP_SKIPPED:
                raise BadInput(f"a record has {length} bytes", where, f"at most {limits.CHUNK}: `mcap` writes smaller chunks")
            if kind == MCAP_CHUNK:
                chunks[start] = _check_chunk(stream, length, allowance, where)
        listed: set[int] = set()
        spans: list[tuple[int, int, int]] = []
        for kind, _, length in _records(stream, summary, footer):
            if kind == MCAP_CHUNK_INDEX:
                start, chunk, first, last = _indexed(stream.read(length))
                if start in listed or chunks.get(start) != chunk:
                    what = f"its index lists a chunk at byte {start} that is not there or is listed twice"
                    raise BadInput(what, str(file), CLOSED_BAG)
                listed.add(start)
                spans.append((first, last, chunk.expanded))
    if (most := _largest_overlap(spans)) > limits.CHUNKS_AT_ONCE:
        what = f"chunks of {most} bytes overlap in time"
        raise BadInput(what, str(file), f"at most {limits.CHUNKS_AT_ONCE}: `mcap sort` writes such a file")


def _largest_overlap(spans: Sequence[tuple[int, int, int]]) -> int:
    """Return the largest total size of chunks that overlap in time; each is given by first time, last time and size."""
    # At equal times, starts come before ends.
    begins = [(first, 0, size) for first, _, size in spans]
    ends = [(max(first, last), 1, -size) for first, last, size in spans]
    return max(accumulate(size for _, _, size in sorted(begins + ends)), default=0)


def _records(stream: BinaryIO, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, start and content length of the records between two offsets, with the stream at the content."""
    while start < end:
        stream.seek(start)
        kind, length = MCAP_RECORD.unpack(stream.read(MCAP_RECORD.size))
        if start + MCAP_RECORD.size + length > end:
            raise ValueError("a record extends beyond its section")
        yield kind, start, length
        start += MCAP_RECORD.size + length


def _check_chunk(stream: BinaryIO, length: int, allowance: Allowance, where: str) -> _Chunk:
    content = stream.read(length)
    _, _, expanded, _, name_length = CHUNK_HEAD.unpack_from(content)
    at = CHUNK_HEAD.size + name_length
    compression = content[CHUNK_HEAD.size : at].decode()
    (compressed,) = struct.unpack_from("<Q", content, at)
    data = content[at + 8 :]
    if len(data) != compressed:
        raise ValueError("a chunk's length is wrong")
    if compression and compression not in STREAMS:
        raise BadInput(f"its compression is {compression!r}", where, f"one of {', '.join(STREAMS)}")
    if expanded > limits.CHUNK:
        raise BadInput(f"a chunk expands to {expanded} bytes", where, f"at most {limits.CHUNK}: `mcap` writes smaller chunks")
    found = len(data)
    if compression:
        found = 0
        for piece in _pieces(compression, BytesIO(data)):
            found += len(piece)
            allowance.spend(len(piece), where)
            if found > expanded:
                break
    if found != expanded:
        raise BadInput(f"a chunk does not expand to {expanded} bytes, as it states", where, CLOSED_BAG)
    return _Chunk(compression, compressed, expanded)


def _indexed(content: bytes) -> tuple[int, _Chunk, int, int]:
    """Return start, description, first and last time [ns] of a chunk from its index record."""
    first, last, start, _, offsets = INDEX_HEAD.unpack_from(content)
    at = INDEX_HEAD.size + offsets + 8
    (name_length,) = struct.unpack_from("<I", content, at)
    compression = content[at + 4 : at + 4 + name_length].decode()
    compressed, expanded = struct.unpack_from("<QQ", content, at + 4 + name_length)
    return start, _Chunk(compression, compressed, expanded), first, last


def expanded(compression: str, data: bytes, size: int) -> bytes | None:
    """Expand a chunk; None if it does not expand to the given size [B], or is damaged."""
    content = bytearray()
    try:
        for piece in _pieces(compression, BytesIO(data)):
            content += piece
            if len(content) > size:
                return None
    except (KeyError, EOFError, RuntimeError, ValueError, OSError, zstd.ZstdError):
        return None
    return bytes(content) if len(content) == size else None


def _pieces(compression: str, stream: BinaryIO) -> Iterator[bytes]:
    with STREAMS[compression](stream) as expanding:
        while piece := expanding.read(PIECE):
            yield piece


def expanded_message(message: bytes, allowance: Allowance, where: str) -> bytes:
    """Expand one message if it is compressed.

    Args:
        message: one zstd frame, or a message as CDR, which begins differently.
        allowance: allowance of the bag.
        where: the bag, for the error.

    Raises:
        BadInput: the message expands beyond the allowance, or is not exactly one frame.
    """
    if message[: len(FRAME)] != FRAME:
        return message
    decompressor = zstd.ZstdDecompressor()
    content: bytes = decompressor.decompress(message, allowance.left + 1)
    allowance.spend(len(content), where)
    if not decompressor.eof or decompressor.unused_data:
        raise BadInput("a compressed message is truncated or has trailing bytes", where, "one zstd frame per message")
    return content


@contextmanager
def expanded_files(files: Sequence[Path], allowance: Allowance) -> Iterator[list[Path]]:
    """Expand the compressed ones of a bag's files into a temporary folder. Messages are left to :func:`expanded_message`.

    Args:
        files: the files, in one folder.
        allowance: allowance of the bag.

    Yields:
        The uncompressed files.

    Raises:
        BadInput: the files expand beyond the allowance.
    """
    with TemporaryDirectory() as temporary:
        plain = []
        for file in files:
            compressed = file.suffix == ".zstd"
            plain.append(Path(temporary) / file.stem if compressed else file)
            if not compressed:
                continue
            with file.open("rb") as source, plain[-1].open("xb") as target:
                for piece in _pieces("zstd", source):
                    allowance.spend(len(piece), str(file))
                    target.write(piece)
        try:
            yield plain
        except BadInput as error:
            # The temporary folder is of no use to the user.
            folder = str(files[0].parent)
            raise BadInput(error.what, error.where.replace(temporary, folder), error.expected) from None
