"""What is compressed in a bag, taken apart within bounds.

A few bytes of zstd or LZ4 can stand for gigabytes, and an index can name one chunk a million times. rosbags expands whatever
it is told to. So the chunks of an mcap file are looked at before it is opened, and compressed messages and files are
expanded here, all of them from one allowance: a multiple of the bag's size on disk.
"""

import struct
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from itertools import accumulate
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import yaml

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.deadline import Deadline
from ehls_ros.recording.limits import EXPANDED, EXPANSION
from ehls_ros.recording.storage_file import (
    CLOSED_BAG,
    MCAP_CHUNK,
    MCAP_CHUNK_INDEX,
    MCAP_FOOTER,
    MCAP_MAGIC,
    MCAP_RECORD,
    METADATA_FILE,
)

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

PIECE = 1 << 20
"""What is expanded at a time [B]."""

STREAMS: Mapping[str, Callable[[BinaryIO], Any]] = {"zstd": zstd.open, "lz4": lz4.frame.open}
"""Readers by the name of the compression."""

MCAP_SKIPPED = (0x09, 0x0C)
"""Attachments and metadata, of which rosbags reads the length alone."""

CHUNK_HEAD = struct.Struct("<QQQII")
INDEX_HEAD = struct.Struct("<QQQQI")


class Allowance:
    """What one bag may still expand to."""

    def __init__(self, size: int) -> None:
        """Begin with the whole of it.

        Args:
            size: of the bag on disk [B].
        """
        self._size = size
        self.left = EXPANDED + EXPANSION * size

    def spend(self, count: int, where: str) -> None:
        """Count what was expanded.

        Args:
            count: how much [B].
            where: of what.

        Raises:
            BadInput: it is more than the bag may expand to.
        """
        self.left -= count
        if self.left < 0:
            what = f"its {self._size} bytes expand to more than {EXPANDED + EXPANSION * self._size}"
            expected = f"a bag that is compressed {EXPANSION}-fold at most, or not: `ros2 bag convert` writes such a one"
            raise BadInput(what, where, expected)


class _Chunk(NamedTuple):
    """A chunk as itself and the file's index describe it; sizes in bytes."""

    compression: str
    compressed: int
    expanded: int


def check_chunks(file: Path, allowance: Allowance, deadline: Deadline) -> None:
    """Look at the chunks of an mcap file: what they expand to, and whether the index names each of them but once.

    Args:
        file: whole at its end, as :func:`~ehls_ros.recording.storage_file.custom_data_in` finds.
        allowance: what the bag may still expand to.
        deadline: until when.

    Raises:
        BadInput: a chunk expands to something else than it says, or to more than is allowed; the index is another file's; or
            it makes rosbags hold too many chunks at once.
        OSError: the file cannot be read.
        ValueError: its records are none.
        struct.error: likewise.
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
        named: set[int] = set()
        spans: list[tuple[int, int, int]] = []
        for kind, _, length in _records(stream, summary, footer):
            if kind == MCAP_CHUNK_INDEX:
                start, chunk, first, last = _indexed(stream.read(length))
                if start in named or chunks.get(start) != chunk:
                    what = f"its index names a chunk at byte {start} that is not there, or twice"
                    raise BadInput(what, str(file), CLOSED_BAG)
                named.add(start)
                spans.append((first, last, chunk.expanded))
    if (most := _at_once(spans)) > limits.CHUNKS_AT_ONCE:
        what = f"chunks of {most} bytes overlap in time"
        raise BadInput(what, str(file), f"at most {limits.CHUNKS_AT_ONCE}: `mcap sort` writes such a file")


def _at_once(spans: Sequence[tuple[int, int, int]]) -> int:
    """Return the most bytes of chunks, given by first time, last time and size, whose times overlap."""
    # At one time the chunks that begin go before those that end.
    begins = [(first, 0, size) for first, _, size in spans]
    ends = [(max(first, last), 1, -size) for first, last, size in spans]
    return max(accumulate(size for _, _, size in sorted(begins + ends)), default=0)


def _records(stream: BinaryIO, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, start and content's length of the records between two places, the stream being at the content."""
    while start < end:
        stream.seek(start)
        kind, length = MCAP_RECORD.unpack(stream.read(MCAP_RECORD.size))
        if start + MCAP_RECORD.size + length > end:
            raise ValueError("a record goes beyond its section")
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
        raise ValueError("a chunk is not as long as it says")
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
        raise BadInput(f"a chunk says that it expands to {expanded} bytes, and does not", where, CLOSED_BAG)
    return _Chunk(compression, compressed, expanded)


def _indexed(content: bytes) -> tuple[int, _Chunk, int, int]:
    """Return where a chunk index says that a chunk is, what it is, and its first and last time [ns]."""
    first, last, start, _, offsets = INDEX_HEAD.unpack_from(content)
    at = INDEX_HEAD.size + offsets + 8
    (name_length,) = struct.unpack_from("<I", content, at)
    compression = content[at + 4 : at + 4 + name_length].decode()
    compressed, expanded = struct.unpack_from("<QQ", content, at + 4 + name_length)
    return start, _Chunk(compression, compressed, expanded), first, last


def _pieces(compression: str, stream: BinaryIO) -> Iterator[bytes]:
    with STREAMS[compression](stream) as expanding:
        while piece := expanding.read(PIECE):
            yield piece


def expanded_message(message: bytes, allowance: Allowance, where: str) -> bytes:
    """Expand one compressed message.

    Args:
        message: a frame of zstd.
        allowance: what the bag may still expand to.
        where: bag, for the error.

    Raises:
        BadInput: it expands to more than is allowed, or is no whole frame.
    """
    decompressor = zstd.ZstdDecompressor()
    content: bytes = decompressor.decompress(message, allowance.left + 1)
    allowance.spend(len(content), where)
    if not decompressor.eof or decompressor.unused_data:
        raise BadInput("a compressed message is cut, or has something behind it", where, "one frame of zstd a message")
    return content


@contextmanager
def laid_open(folder: Path, metadata: Any, allowance: Allowance) -> Iterator[Path]:
    """Show a compressed bag to rosbags as one that is not, in a folder of its own that goes when this is left.

    Files that are compressed are expanded there. Compressed messages stay, for :func:`expanded_message`.

    Args:
        folder: of the bag.
        metadata: what its metadata.yaml says.
        allowance: what the bag may expand to.

    Yields:
        The folder; the given one where nothing has to be done.

    Raises:
        BadInput: the files expand to more than is allowed, or their compression is not zstd.
    """
    information = metadata["rosbag2_bagfile_information"]
    mode = compression_mode(metadata)
    if mode not in ("file", "message"):
        yield folder
        return
    if information["compression_format"] != "zstd":
        raise BadInput(f"its compression is {information['compression_format']!r}", str(folder), "zstd")
    with TemporaryDirectory() as temporary:
        names = []
        for path in information["relative_file_paths"]:
            source = folder / PurePath(path).name
            names.append(source.stem if mode == "file" else source.name)
            target = Path(temporary) / names[-1]
            if mode == "message":
                target.symlink_to(source.absolute())
                continue
            with source.open("rb") as compressed, target.open("xb") as plain:
                for piece in _pieces("zstd", compressed):
                    allowance.spend(len(piece), str(source))
                    plain.write(piece)
        plainly = {"compression_mode": "", "compression_format": "", "relative_file_paths": names}
        text = yaml.safe_dump({"rosbag2_bagfile_information": {**information, **plainly}})
        (Path(temporary) / METADATA_FILE).write_text(text, encoding="utf-8")
        try:
            yield Path(temporary)
        except BadInput as error:
            # The user knows nothing of this folder.
            raise BadInput(error.what, error.where.replace(temporary, str(folder)), error.expected) from None


def compression_mode(metadata: Any) -> str:
    """Return what is compressed: ``file``, ``message``, ``storage`` or nothing; of metadata as a metadata.yaml has them."""
    return str(metadata["rosbag2_bagfile_information"].get("compression_mode") or "").lower()
