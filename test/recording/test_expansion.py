"""Decompression bombs are refused before they take memory or disk; genuinely compressed bags are read."""

import resource
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import lz4.frame
import pytest
import yaml
from patience import PATIENCE
from recorded_runs import loader_state, record, serialized, storage_file
from rosbags.rosbag2 import CompressionMode, storage_mcap

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.limits import EXPANDED, EXPANSION
from ehls_ros.recording.storage_file import MCAP_CHUNK, MCAP_CHUNK_INDEX, MCAP_RECORD

zstd = storage_mcap.zstd

HUGE = 10 * EXPANDED
"""Expanded size of the bombs [B], far beyond the limit."""

MEMORY = 500 << 20
"""Memory of the reading process [B], less than a bomb expands to."""

READ = """
import sys
from pathlib import Path
from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
try:
    read_bag(Path(sys.argv[1]))
except BadInput as error:
    print(error)
"""


def refused(bag: Path) -> str:
    """Return the refusal by a process with too little memory and disk for the expanded bag."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_FSIZE, (2 * EXPANDED, 2 * EXPANDED))

    command = [sys.executable, "-c", READ, str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False, preexec_fn=limit)
    assert done.returncode == 0, done.stderr
    return done.stdout


def zeros(compress: Callable[[], object]) -> bytes:
    """Return a bomb of compressed zeros."""
    compressor = compress()
    begin = compressor.begin() if hasattr(compressor, "begin") else b""
    content = begin + b"".join(compressor.compress(bytes(1 << 20)) for _ in range(HUGE >> 20))
    return content + compressor.flush()


def chunks(content: bytes) -> list[tuple[int, int]]:
    """Return start and end of the chunks of an mcap file."""
    found, at = [], 8
    while at < len(content) - 8:
        kind, length = MCAP_RECORD.unpack_from(content, at)
        end = at + MCAP_RECORD.size + length
        if kind == MCAP_CHUNK:
            found.append((at, end))
        at = end
    return found


def with_chunk(bag: Path, compression: str, data: bytes, expanded: int) -> Path:
    """Replace the content of a bag's only chunk and drop the summary, so that readers scan the file."""
    file = storage_file(bag)
    content = file.read_bytes()
    [(start, _)] = chunks(content)
    times = content[start + 9 : start + 25]
    name = compression.encode()
    chunk = times + struct.pack("<QII", expanded, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    head = content[:start] + MCAP_RECORD.pack(MCAP_CHUNK, len(chunk)) + chunk
    data_end = MCAP_RECORD.pack(0x0F, 4) + bytes(4)
    footer = MCAP_RECORD.pack(0x02, 20) + bytes(20) + content[-8:]
    file.write_bytes(head + data_end + footer)
    return file


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("says", [HUGE, 100])
def test_a_chunk_that_expands_too_far(tmp_path: Path, compression: str, says: int):
    compress = {"zstd": zstd.ZstdCompressor, "lz4": lz4.frame.LZ4FrameCompressor}[compression]
    bag = record(tmp_path / "bomb", [loader_state(0)], compression=CompressionMode.STORAGE)
    file = with_chunk(bag, compression, zeros(compress), says)
    words = f"a chunk expands to {HUGE} bytes" if says == HUGE else "a chunk does not expand to 100 bytes"
    message = refused(file)
    assert words in message
    assert f"{file}, byte " in message


def test_messages_that_expand_too_far(tmp_path: Path):
    bag = record(tmp_path / "bomb", [loader_state(0)], "sqlite3", compression=CompressionMode.MESSAGE)
    with closing(sqlite3.connect(storage_file(bag))) as database, database:
        database.execute("UPDATE messages SET data = ?", (zeros(zstd.ZstdCompressor),))
    message = refused(bag)
    assert "expand to more than" in message
    assert f"{EXPANSION}:1" in message


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_file_that_expands_too_far(tmp_path: Path, storage: str):
    bag = record(tmp_path / "bomb", [loader_state(0)], storage, compression=CompressionMode.FILE)
    [file] = bag.glob("*.zstd")
    file.write_bytes(file.read_bytes() + zeros(zstd.ZstdCompressor))
    message = refused(bag)
    assert "expand to more than" in message
    assert str(file) in message
    assert not list(tmp_path.glob("tmp*"))


@pytest.mark.parametrize("compression", [CompressionMode.STORAGE, CompressionMode.NONE])
def test_an_index_that_lists_a_chunk_twice(tmp_path: Path, compression: CompressionMode):
    bag = record(tmp_path / "theirs", [loader_state(k) for k in range(5)], compression=compression)
    file = storage_file(bag)
    content = file.read_bytes()
    (summary,) = struct.unpack_from("<Q", content, len(content) - 28)
    at = summary
    while content[at] != MCAP_CHUNK_INDEX:
        at += MCAP_RECORD.size + MCAP_RECORD.unpack_from(content, at)[1]
    end = at + MCAP_RECORD.size + MCAP_RECORD.unpack_from(content, at)[1]
    file.write_bytes(content[:end] + content[at:end] + content[end:])
    with pytest.raises(BadInput, match="that is not there or is listed twice"):
        read_bag(file)


@pytest.mark.parametrize("name", ["message_count", "uncompressed size", "chunk length"])
def test_absurd_sizes_and_counts(tmp_path: Path, name: str):
    bag = record(tmp_path / "theirs", [loader_state(k) for k in range(5)], compression=CompressionMode.STORAGE)
    file = storage_file(bag)
    content = bytearray(file.read_bytes())
    [(start, _)] = chunks(bytes(content))
    if name == "message_count":
        metadata = bag / "metadata.yaml"
        entries = yaml.safe_load(metadata.read_text(encoding="utf-8"))
        entries["rosbag2_bagfile_information"]["topics_with_message_count"][0]["message_count"] = 2**62
        metadata.write_text(yaml.safe_dump(entries), encoding="utf-8")
    else:
        place = start + (25 if name == "uncompressed size" else 1)
        content[place : place + 8] = struct.pack("<Q", 2**62)
        file.write_bytes(content)
    message = refused(bag)
    assert "\n" not in message.strip()
    assert str(2**62) in message or "extends beyond its section" in message


@pytest.mark.parametrize("wrong", ["cut", "two frames"])
def test_a_compressed_message_that_is_no_frame(tmp_path: Path, wrong: str):
    bag = record(tmp_path / "theirs", [loader_state(0)], "sqlite3", compression=CompressionMode.MESSAGE)
    frame = zstd.compress(serialized(loader_state(0)))
    with closing(sqlite3.connect(storage_file(bag))) as database, database:
        database.execute("UPDATE messages SET data = ?", (frame[:-3] if wrong == "cut" else frame + frame,))
    with pytest.raises(BadInput, match="a compressed message is truncated or has trailing bytes"):
        read_bag(bag)


def test_an_error_in_a_compressed_file_names_the_bag(tmp_path: Path):
    bag = record(tmp_path / "theirs", [loader_state(0)], compression=CompressionMode.FILE)
    [file] = bag.glob("*.zstd")
    file.write_bytes(zstd.compress(zstd.decompress(file.read_bytes())[:-10]))
    with pytest.raises(BadInput, match="truncated") as caught:
        read_bag(bag)
    assert caught.value.where == str(bag / file.stem)


def test_a_chunk_of_lz4_is_read(tmp_path: Path):
    bag = record(tmp_path / "theirs", [loader_state(k, force=float(k)) for k in range(5)])
    content = storage_file(bag).read_bytes()
    [(start, end)] = chunks(content)
    messages = content[start + 49 : end]  # after the header, which names no compression
    file = with_chunk(bag, "lz4", lz4.frame.compress(messages), len(messages))
    assert read_bag(file)["force_n"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
