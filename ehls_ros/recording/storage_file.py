"""Checks of a single storage file of a bag, and reading of the metadata inside it.

A closed bag has its metadata twice: in metadata.yaml and inside the storage file, where rosbags does not read them. The second
copy holds the provenance of a storage file that was taken out of its folder.
"""

import sqlite3
import struct
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording import limits
from ehls_ros.recording.limits import Deadline
from ehls_ros.recording.topics import CYCLE_TOPICS
from ehls_ros.recording.yaml_text import parse_yaml

METADATA_FILE = "metadata.yaml"

CLOSED_BAG = "an undamaged bag, closed by its recorder"

MCAP_MAGIC = b"\x89MCAP0\r\n"
MCAP_RECORD = struct.Struct("<BQ")
MCAP_FOOTER = struct.Struct("<BQQQI8s")
MCAP_ENCODINGS = ("", "ros2msg", "ros2idl", "omgidl")
"""Readable kinds of type definitions."""
MCAP_SCHEMA, MCAP_CHANNEL, MCAP_MESSAGE, MCAP_CHUNK, MCAP_CHUNK_INDEX, MCAP_METADATA_INDEX = 0x03, 0x04, 0x05, 0x06, 0x08, 0x0D
MCAP_LEDGER = 0x80
"""The first kind of record reserved for applications; other readers skip it."""
MCAP_CHUNK_CRC = 24
"""Offset of the checksum in a chunk's record [B]."""

SQLITE_LEDGER = "ehls_ros_ledger"
"""Table of the ledger."""

SQLITE_MAGIC = b"SQLite format 3\0"


def custom_data_in(file: Path, deadline: Deadline) -> Mapping[str, str]:
    """Check that a storage file is complete, and read its custom data.

    Args:
        file: a ``.mcap`` or ``.db3`` file.
        deadline: deadline of the reading.

    Returns:
        The entries; none if the recorder stored no metadata in the file.

    Raises:
        BadInput: the file is truncated, damaged or was never closed, or reading takes too long.
    """
    try:
        text = _mcap_metadata(file) if file.suffix == ".mcap" else _sqlite_metadata(file, deadline)
        metadata = parse_metadata(text, str(file))
    except BadInput:
        raise
    except OSError as error:
        raise BadInput(f"the file cannot be read ({reason(error)})", str(file), CLOSED_BAG) from None
    except sqlite3.DataError:
        raise BadInput("it contains a text of too many bytes", str(file), f"at most {limits.TEXT}") from None
    except (ValueError, struct.error, sqlite3.Error):
        deadline.check()
        raise BadInput("the file is damaged", str(file), CLOSED_BAG) from None
    custom_data = metadata.get("custom_data") if isinstance(metadata, dict) else None
    return custom_data if isinstance(custom_data, dict) else {}


def parse_metadata(text: str, where: str) -> Any:
    """Parse the metadata of a bag.

    Args:
        text: content of a metadata.yaml.
        where: its file, for the error.

    Raises:
        BadInput: the text is not YAML.
    """
    try:
        return parse_yaml(text, where, "the metadata")
    except BadInput as error:
        raise BadInput(error.what, error.where, CLOSED_BAG) from None


def check_database(database: sqlite3.Connection) -> None:
    """Reject a database on which a query could run forever: with damaged pages, views, triggers or computed columns.

    Args:
        database: database of a bag.

    Raises:
        ValueError: the database is rejected.
        sqlite3.Error: it is not a database.
    """
    for name, definition in database.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall():
        if not str(definition).upper().startswith(("CREATE TABLE", "CREATE INDEX")):
            raise ValueError(f"{name} is neither table nor index")
        if database.execute("SELECT 1 FROM pragma_table_xinfo(?) WHERE hidden", (name,)).fetchone():
            raise ValueError(f"{name} has computed columns")
    if database.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
        raise ValueError("quick_check")


def _check_contents(database: sqlite3.Connection, file: Path) -> None:
    """Reject a database with too many or too large topics, or too large messages on the topics that are read."""
    names = {topic.name for topic in CYCLE_TOPICS}
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    read, rows, size = list[int](), 0, 0
    for table in sorted(tables & {"topics", "message_definitions"}):
        for row in database.execute(f"SELECT * FROM {table}"):  # noqa: S608 - one of the two
            rows += 1
            size += sum(len(value) for value in row if isinstance(value, str | bytes))
            if rows > limits.TOPICS or size > limits.SUMMARY:
                what = f"it has at least {rows} topics and types of {size} bytes"
                raise BadInput(what, str(file), f"at most {limits.TOPICS}, and {limits.SUMMARY} bytes")
            if table == "topics" and str(row[1]).rpartition("/")[2] in names:
                read.append(row[0])
    if tables >= {"topics", "messages"}:
        which = ",".join("?" * len(read))
        largest = f"SELECT max(length(data)) FROM messages WHERE topic_id IN ({which})"  # noqa: S608 - question marks
        ((length,),) = database.execute(largest, read)
        if isinstance(length, int) and length > limits.MESSAGE:
            raise BadInput(f"a message has {length} bytes", str(file), f"at most {limits.MESSAGE}")


def _cut(file: Path) -> BadInput:
    return BadInput("the file is truncated or still being written", str(file), CLOSED_BAG)


def _mcap_metadata(file: Path) -> str:
    """Return the metadata.yaml inside an mcap file, from the last metadata record listed in its summary."""
    with file.open("rb") as stream:
        content_end = stream.seek(0, 2) - MCAP_FOOTER.size
        if content_end < 0:
            raise _cut(file)
        stream.seek(content_end)
        _, _, summary_start, _, _, magic = MCAP_FOOTER.unpack(stream.read())
        if magic != MCAP_MAGIC:
            raise _cut(file)
        stream.seek(0)
        profile = _mcap_text(stream.read(limits.TEXT), len(MCAP_MAGIC) + MCAP_RECORD.size)[0]
        if profile != "ros2":
            raise BadInput(f"its profile is {profile!r}", str(file), "a file of ROS 2, with the profile 'ros2'")
        record = b""
        if 0 < summary_start < content_end:
            stream.seek(summary_start)
            if content_end - summary_start > limits.SUMMARY:
                what = f"its summary has {content_end - summary_start} bytes"
                raise BadInput(what, str(file), f"at most {limits.SUMMARY}")
            summary = stream.read(content_end - summary_start)
            offset = 0
            while offset < len(summary):
                kind, length = MCAP_RECORD.unpack_from(summary, offset)
                offset += MCAP_RECORD.size
                if kind == MCAP_SCHEMA:
                    _check_schema(summary, offset + 2, file)
                if kind == MCAP_METADATA_INDEX:
                    start, size = struct.unpack_from("<QQ", summary, offset)
                    stream.seek(min(start, content_end))
                    record = stream.read(min(size, content_end, limits.TEXT))
                offset += length
    return _mcap_entries(record[MCAP_RECORD.size :]).get("serialized_metadata", "")


def _check_schema(summary: bytes, offset: int, file: Path) -> None:
    name, offset = _mcap_text(summary, offset)
    encoding, _ = _mcap_text(summary, offset)
    if encoding not in MCAP_ENCODINGS:
        expected = "types of ROS 2 (ros2msg or ros2idl); `mcap filter` leaves topics out"
        raise BadInput(f"type {name} is defined as {encoding}", str(file), expected)


def _mcap_entries(content: bytes) -> dict[str, str]:
    """Return the entries of a metadata record: a name, the size of the rest, then keys and values."""
    texts: list[str] = []
    _, offset = _mcap_text(content, 0) if content else ("", 0)
    offset += 4
    while offset < len(content):
        text, offset = _mcap_text(content, offset)
        texts.append(text)
    return dict(zip(texts[::2], texts[1::2], strict=True))


def _mcap_text(content: bytes, offset: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", content, offset)
    end = offset + 4 + length
    return content[offset + 4 : end].decode(), end


def _sqlite_metadata(file: Path, deadline: Deadline) -> str:
    """Return the metadata.yaml inside a SQLite file."""
    with file.open("rb") as stream:
        header = stream.read(100)
    if len(header) < 100:
        raise _cut(file)
    if not header.startswith(SQLITE_MAGIC):
        raise BadInput("the file is not a SQLite database", str(file), CLOSED_BAG)
    page_size = int.from_bytes(header[16:18], "big")
    pages = int.from_bytes(header[28:32], "big")
    if file.stat().st_size < (page_size if page_size > 1 else 65536) * pages:
        raise _cut(file)
    for journal in (f"{file}-journal", f"{file}-wal"):
        if Path(journal).exists() and Path(journal).stat().st_size:
            raise BadInput(f"the file was never closed: {Path(journal).name} is beside it", str(file), CLOSED_BAG)
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
        # Larger values cannot be fetched.
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits.TEXT)
        database.set_progress_handler(deadline.passed, 1000)
        check_database(database)
        _check_contents(database, file)
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        last = "SELECT metadata FROM metadata ORDER BY id DESC LIMIT 1"
        row = database.execute(last).fetchone() if "metadata" in tables else None
        if row is None and SQLITE_LEDGER in tables:
            # Our recorder writes the metadata last.
            raise _cut(file)
        return str(row[0]) if row else ""
