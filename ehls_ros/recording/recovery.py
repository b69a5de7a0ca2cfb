"""Bags whose recorder died: what was flushed is whole, is verified message by message and becomes a bag again.

The storage file of a killed recorder lacks its end; what the note beside it vouches for
(:mod:`ehls_ros.recording.recording_note`) is in it nevertheless.
"""

import os
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, cast

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_writer import NEW_FOLDER, BagWriter, Storage
from ehls_ros.recording.provenance import message_checksum
from ehls_ros.recording.reason import reason
from ehls_ros.recording.recording_note import RECOVERABLE, Note, read_note
from ehls_ros.recording.storage_file import MCAP_CHUNK, MCAP_MAGIC, MCAP_RECORD, check_database
from ehls_ros.recording.topics import TOPICS

SOUND_DISK = "a disk that keeps what was written to it"

MCAP_CHANNEL, MCAP_MESSAGE = 0x04, 0x05
MCAP_MESSAGE_HEAD = struct.Struct("<HIQQ")
MCAP_CHUNK_HEAD = struct.Struct("<QQQIIQ")  # as it is without compression


class Message(NamedTuple):
    """One message as a storage file has it.

    Attributes:
        topic: full name.
        stamp_ns: when it was sent [ns].
        serialized: as CDR.
    """

    topic: str
    stamp_ns: int
    serialized: bytes


def recover(folder: Path, out: Path) -> int:
    """Make a whole bag from one whose recorder died.

    Args:
        folder: what the recorder left behind; it stays as it is.
        out: folder of the new bag, to be made; on failure it is not there.

    Returns:
        The number of messages in the new bag.

    Raises:
        BadInput: nothing can be recovered there, something the note vouches for is missing or damaged, or the new bag
            cannot be made.
        OSError: the disk is full or fails.
    """
    note = read_note(folder)
    if out.exists():
        raise BadInput("the output exists already", str(out), NEW_FOLDER)
    with _becoming(out) as unfinished:
        return _recover(folder, note, unfinished)


@contextmanager
def _becoming(out: Path) -> Iterator[Path]:
    """Yield a folder to be made beside another, which becomes the other unless something goes wrong; then nothing is left."""
    beside = next(parent for parent in out.parents if parent.exists())
    try:
        temporary = TemporaryDirectory(prefix=".recovering-", dir=beside)
    except OSError as error:
        raise BadInput(f"the output cannot be made ({reason(error)})", str(beside), NEW_FOLDER) from None
    with temporary as unfinished:
        try:
            yield Path(unfinished) / out.name
        except BadInput as error:
            # The user knows nothing of this folder.
            raise BadInput(error.what, error.where.replace(unfinished, str(out.parent)), error.expected) from None
        out.parent.mkdir(parents=True, exist_ok=True)
        (Path(unfinished) / out.name).rename(out)


def _recover(folder: Path, note: Note, out: Path) -> int:
    """Write what the note vouches for into a new bag and return the number of its messages."""
    names = {topic.resolve(note.namespace): topic for topic in TOPICS}
    unknown = next((path for path in note.flushed if path not in names), None)
    if unknown is not None:
        raise BadInput(f"the note vouches for {unknown}", str(folder), f"topics in {note.namespace}")
    topics = [names[path] for path in note.flushed]
    writer = BagWriter.create(out, cast(Storage, note.storage), note.configuration, namespace=note.namespace, topics=topics)
    recovered = 0
    try:
        for message in _flushed_messages(folder, note):
            writer.write(names[message.topic].name, message.stamp_ns, message.serialized)
            recovered += 1
        writer.close()
    except BaseException:
        writer.abort()
        raise
    return recovered


def _flushed_messages(folder: Path, note: Note) -> Iterator[Message]:
    """Read what the note vouches for, in the order it was recorded, and check it."""
    counts, checksums = dict.fromkeys(note.flushed, 0), dict.fromkeys(note.flushed, 0)
    for message in _stored(folder, note.storage):
        topic = message.topic
        if topic in counts and counts[topic] < note.flushed[topic].messages:
            counts[topic] += 1
            checksums[topic] += message_checksum(message.stamp_ns, message.serialized)
            yield message
    for topic, flushed in note.flushed.items():
        if counts[topic] < flushed.messages:
            what = f"only {counts[topic]} of the {flushed.messages} flushed messages on {topic} are left"
            raise BadInput(what, str(folder), SOUND_DISK)
        if checksums[topic] != flushed.checksum:
            raise BadInput(f"messages on {topic} are damaged", str(folder), SOUND_DISK)


def _stored(folder: Path, storage: str) -> Iterator[Message]:
    """Read a storage file as far as it goes."""
    file = folder / f"{folder.resolve().name}{'.mcap' if storage == 'mcap' else '.db3'}"
    if not file.exists():
        raise BadInput(f"{file.name} is missing", str(folder), RECOVERABLE)
    try:
        yield from _stored_in_mcap(file) if storage == "mcap" else _stored_in_sqlite(file)
    except (OSError, sqlite3.Error, struct.error, ValueError) as error:
        raise BadInput(f"the storage file cannot be read ({reason(error)})", str(file), RECOVERABLE) from None


def _stored_in_mcap(file: Path) -> Iterator[Message]:
    """Walk the chunks up to the first that is cut."""
    topics: dict[int, str] = {}
    with file.open("rb") as stream:
        if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise ValueError("it does not begin as an mcap file does")
        size = os.fstat(stream.fileno()).st_size
        while len(head := stream.read(MCAP_RECORD.size)) == MCAP_RECORD.size:
            kind, length = MCAP_RECORD.unpack(head)
            if length > size - stream.tell():
                return
            content = stream.read(length)
            if kind == MCAP_CHUNK:
                yield from _messages_of_chunk(content, topics)


def _messages_of_chunk(content: bytes, topics: dict[int, str]) -> Iterator[Message]:
    *_, compression_length, _ = MCAP_CHUNK_HEAD.unpack_from(content)
    if compression_length:
        raise ValueError("it is compressed, which the recorder does not do")
    offset = MCAP_CHUNK_HEAD.size
    while offset < len(content):
        kind, length = MCAP_RECORD.unpack_from(content, offset)
        offset += MCAP_RECORD.size
        if kind == MCAP_CHANNEL:
            channel, _, name_length = struct.unpack_from("<HHI", content, offset)
            topics[channel] = content[offset + 8 : offset + 8 + name_length].decode()
        elif kind == MCAP_MESSAGE:
            channel, _, stamp_ns, _ = MCAP_MESSAGE_HEAD.unpack_from(content, offset)
            yield Message(topics.get(channel, ""), stamp_ns, content[offset + MCAP_MESSAGE_HEAD.size : offset + length])
        offset += length


def _stored_in_sqlite(file: Path) -> Iterator[Message]:
    """Read the rows; what the recorder was in the middle of is rolled back when the file is opened."""
    with closing(sqlite3.connect(file)) as database:
        check_database(database)
        rows = database.execute(
            "SELECT topics.name, messages.timestamp, messages.data FROM messages "
            "JOIN topics ON topics.id = messages.topic_id ORDER BY messages.id"
        )
        for topic, stamp_ns, serialized in rows:
            if not (isinstance(topic, str) and isinstance(stamp_ns, int) and stamp_ns >= 0 and isinstance(serialized, bytes)):
                raise ValueError("a row is no message")
            yield Message(topic, stamp_ns, serialized)
