"""Salvage of messages and provenance from a damaged or unclosed bag."""

import json
import shutil
import sqlite3
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import NamedTuple

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording.bag_files import STORAGE_SUFFIXES
from ehls_ros.recording.bag_writer import Storage
from ehls_ros.recording.ledger import Ledger
from ehls_ros.recording.limits import TEXT
from ehls_ros.recording.mcap_salvage import expand_chunks, kinds_in_mcap, names_in_mcap, salvage_mcap
from ehls_ros.recording.provenance import Provenance, provenance_in
from ehls_ros.recording.recording_note import Flushed, read_note
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.recording.salvage import Found, Kind, Loss, Salvage
from ehls_ros.recording.sqlite_salvage import kinds_in_sqlite, names_in_sqlite, salvage_sqlite
from ehls_ros.recording.storage_file import MCAP_MAGIC, METADATA_FILE, SQLITE_MAGIC, parse_metadata

JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
"""Magic bytes at the beginning of a rollback journal of SQLite, and at the end of one that names another file."""

MIN_PAGE = 512
"""Smallest page of a SQLite database [B]."""

RECOVERABLE = "a bag of ROS 2, its folder or its storage file"

MAX_PROVENANCE = TEXT * 3 // 4
"""Maximum length of a provenance that is copied to the new bag's metadata, which are limited when read [characters]."""


class DamagedBag(NamedTuple):
    """The remains of one storage file.

    Attributes:
        storage: rosbag2 storage plugin.
        content: content of the file.
        names: full names of the topics by their number in the file.
        kinds: types of the topics, as far as they are known.
        provenance: provenance of the bag; None if it is lost.
        expected: messages written on each topic, by full name, according to the files beside the storage file.
        remarks: remarks on the state of the file.
    """

    storage: Storage
    content: mmap
    names: Mapping[int, str]
    kinds: Mapping[str, Kind]
    provenance: Provenance | None
    expected: Mapping[str, Flushed]
    remarks: Sequence[str]

    def messages(self, ledger: Ledger, loss: Loss) -> Iterator[Found]:
        """Find the messages; see :data:`~ehls_ros.recording.salvage.Salvage`."""
        salvage: Salvage = salvage_mcap if self.storage == "mcap" else salvage_sqlite
        yield from salvage(self.content, self.names, ledger, loss)


def storage_file(source: Path) -> Path:
    """Return the storage file of a bag.

    Args:
        source: the file itself, or a folder that contains it, under any name.

    Raises:
        BadInput: there is none, or more than one.
    """
    if not source.exists():
        raise BadInput("it does not exist", str(source), RECOVERABLE)
    try:
        files = [file for file in sorted(source.iterdir()) if _is_storage(file)] if source.is_dir() else [source]
    except OSError as error:
        raise BadInput(f"it cannot be read ({reason(error)})", str(source), RECOVERABLE) from None
    if len(files) != 1:
        found = f"{len(files)} storage files: {', '.join(file.name for file in files)}" if files else "no storage file"
        raise BadInput(f"there is {found}", str(source), "one of them" if files else RECOVERABLE)
    return files[0]


@contextmanager
def damaged_bag(file: Path, folder: Path) -> Iterator[tuple[DamagedBag, Ledger]]:
    """Open the remains of a bag, and its ledger.

    Args:
        file: its storage file; left unchanged.
        folder: for a copy of the file, if SQLite has to roll back an unfinished transaction.

    Raises:
        BadInput: the file is empty or cannot be read.
    """
    check_regular(file, sys.maxsize, RECOVERABLE)
    try:
        beginning = _beginning(file)
        mcap = beginning.startswith(MCAP_MAGIC) or (file.suffix == ".mcap" and not beginning.startswith(SQLITE_MAGIC))
    except OSError as error:
        raise BadInput(f"it cannot be read ({reason(error)})", str(file), RECOVERABLE) from None
    if not beginning:
        raise BadInput("it is empty", str(file), RECOVERABLE)
    readable = _expanded(file, folder) if mcap else _rolled_back(file, folder)
    with readable.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as content:
        ledger = Ledger(content)
        names = {**(names_in_mcap(content) if mcap else names_in_sqlite(content)), **ledger.names}
        kinds = kinds_in_mcap(content) if mcap else kinds_in_sqlite(content)
        expected, remarks = _expected(file.parent)
        provenance = _provenance(ledger, str(file))
        if provenance is None:
            remarks.append("the configuration of the run is lost")
        if ledger.empty:
            remarks.append("the file has no ledger: messages lost from the middle are not counted")
        elif ledger.damaged_blocks:
            remarks.append(f"{ledger.damaged_blocks} blocks of the file's ledger are damaged")
        yield DamagedBag("mcap" if mcap else "sqlite3", content, names, kinds, provenance, expected, remarks), ledger


def _is_storage(file: Path) -> bool:
    return file.is_file() and (file.suffix in STORAGE_SUFFIXES or _beginning(file).startswith((MCAP_MAGIC, SQLITE_MAGIC)))


def _beginning(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(len(SQLITE_MAGIC))


def _expanded(file: Path, folder: Path) -> Path:
    """Return a copy of an mcap file with its compressed chunks expanded; the file itself if there are none."""
    copy = folder / "copy.mcap"
    with file.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as content, copy.open("wb") as expanded:
        return copy if expand_chunks(content, expanded) else file


def _rolled_back(file: Path, folder: Path) -> Path:
    """Return a copy with the unfinished transaction rolled back; the file itself if there is none."""
    beside = [*file.parent.glob("*-journal"), *file.parent.glob("*-wal")]
    journals = [journal for journal in beside if journal.is_file() and journal.stat().st_size]
    own = [journal for journal in journals if journal.name.startswith(file.name)] or journals
    if len(own) != 1:
        return file
    copy = folder / "copy.db3"
    shutil.copyfile(file, copy)
    journal = Path(f"{copy}-{own[0].name.rpartition('-')[2]}")
    shutil.copyfile(own[0], journal)
    most = copy.stat().st_size + journal.stat().st_size
    if journal.name.endswith("-journal"):
        _bound_journal(journal, most)
    # If this fails, the copy is salvaged unchanged.
    with suppress(sqlite3.Error), closing(sqlite3.connect(copy)) as database:
        database.execute("PRAGMA user_version").fetchone()
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    return copy if 0 < copy.stat().st_size <= most else file


def _bound_journal(journal: Path, most: int) -> None:
    """Patch a rollback journal so that SQLite neither extends the database beyond the available data nor deletes another file.

    SQLite sets the database to the number of pages in the journal's header. It then deletes the super-journal named at the
    journal's end if none of the databases listed there exists.

    Args:
        journal: a copy of the journal.
        most: size of database and journal together [B].
    """
    with journal.open("r+b") as stream:
        magic, pages, page_size = struct.unpack(">8s8xI4xI", stream.read(28).ljust(28, b"\0"))
        # A size of 0 denotes that of the database, which is at least the smallest.
        there = most // max(page_size, MIN_PAGE)
        if magic == JOURNAL_MAGIC and pages > there:
            stream.seek(16)
            stream.write(struct.pack(">I", there))
        stream.seek(-min(len(JOURNAL_MAGIC), stream.seek(0, 2)), 2)
        if stream.read() == JOURNAL_MAGIC:
            stream.seek(-len(JOURNAL_MAGIC), 2)
            stream.write(bytes(len(JOURNAL_MAGIC)))


def _expected(folder: Path) -> tuple[Mapping[str, Flushed], list[str]]:
    """Return the messages written on each topic according to metadata.yaml or the note, with remarks."""
    with suppress(Exception):  # the metadata may be missing, or damaged in any way
        text = (folder / METADATA_FILE).read_text(encoding="utf-8")
        entries = parse_metadata(text, str(folder))["rosbag2_bagfile_information"]["custom_data"]
        closed = provenance_in(entries, str(folder))
        if closed is not None:
            return {path: Flushed(seal.messages, seal.newest_ns) for path, seal in closed.seals.items()}, []
    try:
        return read_note(folder), []
    except BadInput as error:
        return {}, [f"{error.what}: messages lost from the end are not counted"]


def _provenance(ledger: Ledger, where: str) -> Provenance | None:
    """Return the bag's provenance; None if it is lost or would make the new bag unreadable."""
    text = ledger.provenance
    if text is None or len(text) > MAX_PROVENANCE:
        return None
    try:
        provenance = provenance_in(json.loads(text), where)
        # A configuration with NaN differs from itself; the copies in the new bag would disagree.
        return provenance if provenance == provenance_in(json.loads(text), where) else None
    except (BadInput, json.JSONDecodeError):
        return None
