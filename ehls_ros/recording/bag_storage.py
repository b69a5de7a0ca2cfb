"""rosbags' storages, with what tells sound messages from damaged ones: a ledger in the file, and checksums of mcap's chunks.

Everybody can read the bags: a private record of mcap and a table of its own in SQLite are what other readers pass over.
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from zlib import crc32

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from ehls_ros.recording.ledger import LedgerWriter
from ehls_ros.recording.storage_file import MCAP_CHUNK_CRC, MCAP_LEDGER, MCAP_RECORD


class McapStorage(McapWriter):
    """An mcap file: each chunk has its checksum, and before it stands what the ledger says of it."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        """Make the file."""
        super().__init__(path, compression)
        self.ledger = LedgerWriter()

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Add a topic."""
        super().add_connection(connection, offered_qos_profiles)
        self.ledger.add_topic(connection.id, connection.topic)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message."""
        self.ledger.add(connection.id, timestamp, data)
        super().write(connection, timestamp, data)

    def keep(self, blocks: Sequence[bytes]) -> None:
        """Put blocks of the ledger into the file."""
        for block in blocks:
            self.bio.write(MCAP_RECORD.pack(MCAP_LEDGER, len(block)) + block)

    def close_chunk(self) -> None:
        """Write the chunk; the ledger goes first, so that it vouches for the messages of a chunk that is cut."""
        self.keep(self.ledger.take())
        start, checksum = self.bio.tell(), crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + MCAP_RECORD.size + MCAP_CHUNK_CRC)
        self.bio.write(struct.pack("<I", checksum))
        self.bio.seek(end)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        if self.chunk.bio.tell():
            self.close_chunk()
        self.bio.flush()


class SqliteStorage(Sqlite3Writer):
    """A SQLite file: the ledger is a table of it, and committed with the messages it is about."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        """Make the file."""
        super().__init__(path, compression)
        self.ledger = LedgerWriter()
        self.cursor.execute("CREATE TABLE ehls_ros_ledger(id INTEGER PRIMARY KEY, block BLOB NOT NULL)")

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Add a topic."""
        super().add_connection(connection, offered_qos_profiles)
        self.ledger.add_topic(connection.id, connection.topic)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message."""
        self.ledger.add(connection.id, timestamp, data)
        super().write(connection, timestamp, data)

    def keep(self, blocks: Sequence[bytes]) -> None:
        """Put blocks of the ledger into the file."""
        self.cursor.executemany("INSERT INTO ehls_ros_ledger(block) VALUES(?)", [(block,) for block in blocks])

    def flush(self) -> None:
        """Commit."""
        self.keep(self.ledger.take())
        self.conn.commit()

    def close(self, version: int, metadata: str) -> None:
        """Write the metadata and close the file."""
        self.keep(self.ledger.take())
        super().close(version, metadata)


class StorageWriter(Writer):
    """rosbags' writer onto these storages."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, type[McapStorage | SqliteStorage]] = MappingProxyType(
        {StoragePlugin.MCAP: McapStorage, StoragePlugin.SQLITE3: SqliteStorage}
    )
    storage: McapStorage | SqliteStorage | None
