"""The storage files of one bag: which they are, and their messages one file after the other."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader, storage_mcap, storage_sqlite3

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.recording_note import NOTE
from ehls_ros.recording.regular_file import read_text
from ehls_ros.recording.storage_file import CLOSED_BAG, METADATA_FILE, parse_metadata

STORAGE_SUFFIXES = (".mcap", ".db3")

COMPRESSED = ".zstd"
"""Further suffix of a storage file that is compressed as a whole."""

EXPECTED = "a folder of a rosbag2, or a file .mcap or .db3"

REQUIRED = ("version", "duration", "starting_time", "message_count", "topics_with_message_count", "relative_file_paths")
"""Keys of a complete metadata.yaml."""

NUMBERED = re.compile(r"(?P<stem>.*)_(?P<number>[0-9]{1,6})\Z")
"""Name of a split bag's file, without suffix."""

OVERLAP, GAP = 1.0, 10.0
"""Longest time that successive files of one recording have in common, and longest between them [s]."""


class Contents(NamedTuple):
    """The storage files of a bag.

    Attributes:
        files: the files, in order if it is known.
        information: content of metadata.yaml; None without one.
        remarks: one sentence each.
    """

    files: Sequence[Path]
    information: Mapping[str, Any] | None
    remarks: tuple[str, ...] = ()


def is_storage(name: str) -> bool:
    """Return whether a file is a storage file by its name, compressed or not."""
    return PurePath(name.removesuffix(COMPRESSED)).suffix in STORAGE_SUFFIXES


def contents_of(path: Path) -> Contents:
    """Find the storage files of a closed bag.

    Args:
        path: folder of the bag, with or without its metadata.yaml; or one storage file.

    Raises:
        BadInput: there is no bag, or it was not closed.
    """
    if not path.is_dir():
        if not path.exists():
            raise BadInput("it does not exist", str(path), EXPECTED)
        if path.suffix == ".bag":
            raise BadInput("it is a bag of ROS 1", str(path), f"one of ROS 2: `rosbags-convert --src {path} --dst {path.stem}`")
        if not is_storage(path.name):
            raise BadInput("it is not a bag", str(path), EXPECTED)
        return Contents([path], None)
    if (path / NOTE).exists():
        raise BadInput("it is being recorded, or its recorder was killed", str(path), f"`ehls recover {path}` in that case")
    present = sorted(file.name for file in path.iterdir() if is_storage(file.name) and not file.is_dir())
    if not (path / METADATA_FILE).exists():
        if not present:
            expected = "a bag of ROS 2; `rosbags-convert` converts one of ROS 1" if list(path.glob("*.bag")) else EXPECTED
            raise BadInput(f"{METADATA_FILE} is missing, and there is no storage file", str(path), expected)
        remark = f"{METADATA_FILE} is missing: {', '.join(present)} read without it; the last messages may be missing too"
        matches = [NUMBERED.match(name.partition(".")[0]) for name in present]
        numbers = {int(match["number"]) for match in matches if match} if all(matches) else set[int]()
        lacking = sorted(set(range(max(numbers, default=0))) - numbers)
        if lacking and len(lacking) < len(numbers):
            remark += f"; there is no file of number {', '.join(map(str, lacking))}"
        return Contents([path / name for name in present], None, (remark,))
    text = read_text(path / METADATA_FILE, limits.TEXT, CLOSED_BAG)
    information = parse_metadata(text, str(path / METADATA_FILE))["rosbag2_bagfile_information"]
    _check_complete(information, str(path / METADATA_FILE))
    names = [_present(PurePath(name).name, present) for name in information["relative_file_paths"]]
    for name in names:
        # Other names would not be checked; a repeated name would be read repeatedly.
        if not is_storage(name) or names.count(name) > 1:
            expected = f"files {' or '.join(STORAGE_SUFFIXES)}, each once"
            raise BadInput(f"it lists the storage file {name!r}", str(path / METADATA_FILE), expected)
    unlisted = [name for name in present if name not in names and name.removesuffix(COMPRESSED) not in names]
    remarks = (f"{', '.join(unlisted)} is not listed in {METADATA_FILE} and left out",) if unlisted else ()
    return Contents([path / name for name in names], information, remarks)


def _check_complete(information: Mapping[str, Any], where: str) -> None:
    """Reject a truncated metadata.yaml, which may still be YAML."""
    missing = [key for key in REQUIRED if key not in information]
    if missing:
        raise BadInput(f"{METADATA_FILE} has no {' and no '.join(missing)}", where, CLOSED_BAG)
    count = sum(topic["message_count"] for topic in information["topics_with_message_count"])
    if count != information["message_count"]:
        what = f"it lists {count} messages by topic, and {information['message_count']} in all"
        raise BadInput(what, where, CLOSED_BAG)


def _present(name: str, present: Sequence[str]) -> str:
    """Return the name of a listed file, which may have been compressed or expanded after the recording."""
    others = (name, name.removesuffix(COMPRESSED), name + COMPRESSED)
    return next((other for other in others if other in present), name)


@contextmanager
def opened_file(file: Path) -> Iterator[Reader]:
    """Open a storage file, whatever its QoS profiles: incomplete ones occur, and reading needs none."""
    parser, modules = "parse_qos", (storage_mcap, storage_sqlite3)
    originals = [getattr(module, parser) for module in modules]
    reader = Reader(file)
    try:
        for module in modules:
            setattr(module, parser, lambda _: [])
        reader.open()
    finally:
        for module, original in zip(modules, originals, strict=True):
            setattr(module, parser, original)
    try:
        yield reader
    finally:
        reader.close()


class BagFiles:
    """The messages of several storage files as those of one bag."""

    def __init__(self, readers: Sequence[Reader], contents: Contents, where: str) -> None:
        """Combine open files.

        Args:
            readers: reader of each file.
            contents: the files.
            where: the bag, for errors.

        Raises:
            BadInput: without metadata.yaml: the files are not of one recording.
        """
        information = contents.information
        self._readers = readers if information is not None else _in_order(readers, contents.files, where)
        self._found: dict[tuple[str, str], list[tuple[Reader, Connection]]] = defaultdict(list)
        for reader in self._readers:
            for connection in reader.connections:
                self._found[connection.topic, connection.msgtype].append((reader, connection))
        counts = {key: sum(connection.msgcount for _, connection in found) for key, found in self._found.items()}
        digests = {key: found[0][1].digest for key, found in self._found.items()}
        if information is not None:
            listed = information["topics_with_message_count"]
            topics = [(entry["topic_metadata"], entry["message_count"]) for entry in listed]
            counts = {(topic["name"], topic["type"]): count for topic, count in topics}
            digests = {(topic["name"], topic["type"]): topic.get("type_description_hash", "") for topic, _ in topics}
        self.connections = [
            self._connection(number, topic, count, digests[topic]) for number, (topic, count) in enumerate(counts.items(), 1)
        ]

    def _connection(self, number: int, topic: tuple[str, str], count: int, digest: str) -> Connection:
        found = [connection for _, connection in self._found.get(topic, ())]
        definitions = (c.msgdef for c in found if c.msgdef.format is not MessageDefinitionFormat.NONE)
        definition = next(definitions, MessageDefinition(MessageDefinitionFormat.NONE, ""))
        extensions = [c.ext for c in found if isinstance(c.ext, ConnectionExtRosbag2)]
        formats = sorted({extension.serialization_format for extension in extensions} - {"cdr"})
        extension = ConnectionExtRosbag2(formats[0] if formats else "cdr", [])
        return Connection(number, *topic, definition, digest, count, extension, self)

    def messages(self, connections: Sequence[Connection], *, as_written: bool) -> Iterator[tuple[Connection, int, bytes]]:
        """Return the messages of some connections with their times of reception [ns], file by file.

        Args:
            connections: of the bag.
            as_written: in the order of writing; else each file's in the order of their times, which is another one if the
                clock of the recorder was set back.
        """
        for reader in self._readers:
            wanted = {
                own.id: connection
                for connection in connections
                for owner, own in self._found.get((connection.topic, connection.msgtype), ())
                if owner is reader
            }
            chosen = [own for own in reader.connections if own.id in wanted]
            # Given no connection, rosbags reads all of them.
            read = _as_written(reader, chosen) if as_written else reader.messages(chosen)
            for own, stamp_ns, message in read if chosen else ():
                yield wanted[own.id], stamp_ns, message


def _as_written(reader: Reader, connections: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
    """Return the messages of a file in the order of writing, which the readers of rosbags sort by time."""
    storage = reader.storage
    if isinstance(storage, storage_mcap.McapReader):
        yield from storage.messages_scan(connections)
    elif isinstance(storage, storage_sqlite3.Sqlite3Reader) and storage.dbconn is not None:
        own = {connection.id: connection for connection in connections}
        chosen = ",".join("?" * len(own))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({chosen}) ORDER BY id"  # noqa: S608
        for topic, stamp_ns, message in storage.dbconn.execute(query, tuple(own)):
            yield own[topic], stamp_ns, message


def _in_order(readers: Sequence[Reader], files: Sequence[Path], where: str) -> list[Reader]:
    """Sort the files of a split bag, by the numbers in their names if they have some, else by time."""
    names = {id(reader): file.name for reader, file in zip(readers, files, strict=True)}
    matches = [NUMBERED.match(name.partition(".")[0]) for name in names.values()]
    numbered = all(matches) and len({match["stem"] for match in matches if match}) == 1
    numbers = {id(reader): int(match["number"]) for reader, match in zip(readers, matches, strict=True) if match}
    ordered = sorted(readers, key=lambda reader: numbers[id(reader)] if numbered else reader.start_time)
    filled = [reader for reader in ordered if reader.message_count]
    for first, second in pairwise(filled):
        gap = (second.start_time - first.end_time) / 1e9
        if gap > GAP or (gap < -OVERLAP and not numbered):
            relation = f"begins {gap:.4g} s after" if gap > 0.0 else f"begins {-gap:.4g} s before the end of"
            what = f"{METADATA_FILE} is missing, and {names[id(second)]} {relation} {names[id(first)]}"
            raise BadInput(what, where, "the files of one recording, or one of them")
    return ordered
