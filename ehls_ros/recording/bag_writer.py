"""Writing of rosbag2: message by message as a run goes, or a whole trajectory at once."""

import errno
import json
import sqlite3
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Literal, NoReturn, Self, get_args

import numpy as np
from rosbags.rosbag2 import StoragePlugin

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_storage import StorageWriter
from ehls_ros.recording.ledger import provenance_blocks
from ehls_ros.recording.provenance import Provenance, Seal, as_json
from ehls_ros.recording.reason import reason
from ehls_ros.recording.recording_note import Flushed, Note, remove_note, write_note
from ehls_ros.recording.topics import NAMESPACE, TOPICS, Topic
from ehls_ros.recording.trajectory_messages import streams_of
from ehls_ros.recording.typestore import typestore
from ehls_ros.trajectory import SIGNALS, Trajectory

Storage = Literal["mcap", "sqlite3"]

NEW_FOLDER = "a folder that does not exist yet, where it may be written"


class BagWriter:
    """A rosbag2 being written.

    Leaving it as a context manager closes it, also after an exception: what was recorded until then is kept. It
    belongs to the thread that made it.
    """

    def __init__(self, writer: StorageWriter, topics: Sequence[Topic], namespace: str, provenance: Provenance) -> None:
        """Take over an open writer; see :meth:`create`."""
        assert writer.storage is not None  # noqa: S101 - it is open
        self._writer = writer
        self._storage = writer.storage
        self._provenance = provenance
        self._connections = {
            topic.name: writer.add_connection(topic.resolve(namespace), topic.type, typestore=typestore()) for topic in topics
        }
        self._storage.keep(provenance_blocks(json.dumps(provenance.custom_data())))
        self._open = True

    @classmethod
    def create(
        cls,
        path: Path,
        storage: Storage = "mcap",
        metadata: Mapping[str, Any] = MappingProxyType({}),
        *,
        namespace: str = NAMESPACE,
        topics: Sequence[Topic] = TOPICS,
        signals: Sequence[str] | None = None,
    ) -> Self:
        """Make the bag's folder and open it for writing.

        Args:
            path: folder to make; its parents are made as well.
            storage: rosbag2 storage plugin.
            metadata: configuration of the run, kept in the bag as JSON.
            namespace: namespace the topics are in.
            topics: the topics that will be written.
            signals: signals of the trajectory the bag is written from, None when it is recorded.

        Returns:
            The open writer.

        Raises:
            BadInput: the folder exists or cannot be made, or the storage is unknown.
            TypeError: the metadata hold what JSON does not know.
        """
        provenance = Provenance(as_json(metadata), {}, signals)
        if storage not in get_args(Storage):
            raise BadInput(f"storage is {storage!r}", str(path), f"one of {', '.join(get_args(Storage))}")
        if storage == "sqlite3" and set("?#%") & set(str(path)):
            # rosbags hands SQLite the path as part of a URI without quoting it
            raise BadInput("the path holds one of ? # %", str(path), "a path without them, or storage mcap")
        try:
            if path.exists():
                raise BadInput("the output exists already", str(path), NEW_FOLDER)
            writer = StorageWriter(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
            writer.open()
        except (OSError, sqlite3.Error) as error:
            where = getattr(error, "filename", None) or path
            raise BadInput(f"the output cannot be made ({reason(error)})", str(where), NEW_FOLDER) from None
        return cls(writer, topics, namespace, provenance)

    def write(self, topic: str, stamp_ns: int, serialized: bytes) -> None:
        """Write one message.

        Args:
            topic: name of the topic in :data:`~ehls_ros.recording.topics.TOPICS`.
            stamp_ns: when it was sent, not negative [ns].
            serialized: the message as CDR.

        Raises:
            OSError: the disk is full or fails; the bag has then been given up.
        """
        if stamp_ns < 0:
            raise ValueError(f"stamp of a message on {topic} is {stamp_ns} ns; expected 0 or later")
        try:
            self._writer.write(self._connections[topic], stamp_ns, serialized)
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def tell_of_recovery(self, recovery: Mapping[str, Any]) -> None:
        """Let the bag's metadata say what was lost of the damaged bag it is made of.

        Args:
            recovery: JSON values.
        """
        self._provenance = self._provenance._replace(recovery=as_json(recovery))

    def flush(self) -> None:
        """Make sure that what was written survives the death of this process, and note that it does.

        :func:`ehls_ros.recording.recovery.recover` then makes a bag of it.

        Raises:
            OSError: the disk is full or fails; the bag has then been given up, up to the last flush it is recoverable.
        """
        try:
            self._storage.flush()
            flushed = {path: Flushed(tally.messages, tally.newest_ns) for path, tally in self._storage.ledger.tallies().items()}
            write_note(self._writer.path, Note(flushed))
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def close(self) -> None:
        """Write what is still in memory and the metadata; a second call does nothing.

        Raises:
            OSError: the disk is full or fails; the bag has then been given up.
        """
        if not self._open:
            return
        tallies = self._storage.ledger.tallies()
        seals = {
            connection.topic: Seal(connection.digest, tally.checksum, tally.messages, tally.newest_ns)
            for connection in self._connections.values()
            for tally in [tallies[connection.topic]]
        }
        for key, value in self._provenance._replace(seals=seals).custom_data().items():
            self._writer.set_custom_data(key, value)
        try:
            self._writer.close()
            remove_note(self._writer.path)
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)
        self._open = False

    def abort(self) -> None:
        """Stop without metadata, so that nobody takes the rest for a bag; closing does nothing after that."""
        self._open = False
        try:
            self._writer.abort()
        except (OSError, sqlite3.Error):
            return  # the error that led here says more

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the bag."""
        self.close()

    def _give_up(self, error: OSError | sqlite3.Error) -> NoReturn:
        self.abort()
        written = sum(self._writer.counts.values())
        number = (isinstance(error, OSError) and error.errno) or (errno.ENOSPC if "full" in str(error) else errno.EIO)
        what = f"{reason(error)}; the bag is incomplete after {written} messages"
        raise OSError(number, what, str(self._writer.path)) from error


def write_trajectory(path: Path, trajectory: Trajectory, storage: Storage = "mcap") -> None:
    """Write a trajectory as the bag that recording the same run would have made.

    Header stamps are the sample times rounded to nanoseconds, cycles count from 0. A message is left out where all its
    signals are NaN.

    Args:
        path: folder to make.
        trajectory: what to write.
        storage: rosbag2 storage plugin.

    Raises:
        BadInput: the folder cannot be made, or the trajectory holds what messages cannot express.
        OSError: the disk is full or fails.
    """
    streams = streams_of(trajectory, str(path))
    sent_ns = np.concatenate([stream.sent_ns for stream in streams])
    messages = [(stream.topic.name, message) for stream in streams for message in stream.messages]
    order = np.argsort(sent_ns, kind="stable")
    writer = BagWriter.create(
        path,
        storage,
        trajectory.metadata,
        topics=[stream.topic for stream in streams],
        signals=[name for name in SIGNALS if name in trajectory],
    )
    try:
        for stamp_ns, index in zip(sent_ns[order].tolist(), order.tolist(), strict=True):
            name, message = messages[index]
            writer.write(name, stamp_ns, message)
        writer.close()
    except BaseException:
        writer.abort()
        raise
