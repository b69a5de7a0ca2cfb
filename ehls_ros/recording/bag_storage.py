"""Storages of rosbags with protection against damage: a ledger in the file, and checksums of mcap's chunks.

The caller enters topics and messages into the ledger; the storage writes its blocks. Any reader can read the bags: the ledger
is a private record of mcap, or a separate table of SQLite, which others skip.
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from zlib import crc32

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from ehls_ros.recording.ledger import LedgerWriter
from ehls_ros.recording.storage_file import MCAP_CHUNK_CRC, MCAP_LEDGER, MCAP_RECORD, SQLITE_LEDGER


class McapStorage(McapWriter):
    """An mcap file: each chunk has a checksum and is preceded by its part of the ledger."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        """Create the file."""
        super().__init__(path, compression)
        self.ledger = LedgerWriter()

    def write_blocks(self, blocks: Sequence[bytes]) -> None:
        """Write blocks of the ledger."""
        for block in blocks:
            self.bio.write(MCAP_RECORD.pack(MCAP_LEDGER, len(block)) + block)

    def close_chunk(self) -> None:
        """Write the ledger, then the chunk, so that the ledger also covers the messages of a truncated chunk."""
        self.write_blocks(self.ledger.take())
        start, checksum = self.bio.tell(), crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + MCAP_RECORD.size + MCAP_CHUNK_CRC)
        self.bio.write(struct.pack("<I", checksum))
        self.bio.seek(end)

    def flush(self) -> None:
        """Pass everything to the operating system."""
        if self.chunk.bio.tell():
            self.close_chunk()
        self.bio.flush()


class SqliteStorage(Sqlite3Writer):
    """A SQLite file: the ledger is a table, committed together with the messages."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        """Create the file and the table of the ledger."""
        super().__init__(path, compression)
        self.ledger = LedgerWriter()
        self.cursor.execute(f"CREATE TABLE {SQLITE_LEDGER}(id INTEGER PRIMARY KEY, block BLOB NOT NULL)")

    def write_blocks(self, blocks: Sequence[bytes]) -> None:
        """Write blocks of the ledger."""
        self.cursor.executemany(f"INSERT INTO {SQLITE_LEDGER}(block) VALUES(?)", [(block,) for block in blocks])

    def flush(self) -> None:
        """Commit."""
        self.write_blocks(self.ledger.take())
        self.conn.commit()

    def close(self, version: int, metadata: str) -> None:
        """Write the metadata and close the file."""
        self.write_blocks(self.ledger.take())
        super().close(version, metadata)


class StorageWriter(Writer):
    """Writer of rosbags with these storages."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, type[McapStorage | SqliteStorage]] = MappingProxyType(
        {StoragePlugin.MCAP: McapStorage, StoragePlugin.SQLITE3: SqliteStorage}
    )
    storage: McapStorage | SqliteStorage | None
