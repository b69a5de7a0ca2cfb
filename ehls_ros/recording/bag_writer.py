"""Writing of rosbag2: message by message during a run, or a complete trajectory at once."""

import errno
import json
import sqlite3
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Literal, NoReturn, Self, get_args

import numpy as np
from rosbags.interfaces import (
    Connection,
    MessageDefinition,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording.bag_storage import StorageWriter
from ehls_ros.recording.ledger import provenance_blocks
from ehls_ros.recording.provenance import Provenance, Seal, as_json
from ehls_ros.recording.recording_note import Flushed, remove_note, write_note
from ehls_ros.recording.topics import NAMESPACE, TOPICS, Topic
from ehls_ros.recording.trajectory_messages import streams_of
from ehls_ros.recording.typestore import definition, typestore, typestore_of
from ehls_ros.trajectory import SIGNALS, Trajectory

Storage = Literal["mcap", "sqlite3"]

NEW_FOLDER = "a new folder in a writable place"


class BagWriter:
    """A rosbag2 being written.

    As a context manager it is closed on exit, also after an exception, and keeps the messages recorded so far. Use it only in
    the thread that made it.
    """

    def __init__(self, writer: StorageWriter, topics: Sequence[Topic], namespace: str, provenance: Provenance) -> None:
        """Use an open writer; see :meth:`create`."""
        assert writer.storage is not None  # noqa: S101 - it is open
        self._writer = writer
        self._storage = writer.storage
        self._provenance = provenance
        self._namespace = namespace
        self._connections: dict[str, Connection] = {}
        for topic in topics:
            self.add_topic(topic)
        self._storage.write_blocks(provenance_blocks(json.dumps(provenance.custom_data())))
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
        """Create the bag's folder and open it for writing.

        Args:
            path: folder to create, with its parents.
            storage: rosbag2 storage plugin.
            metadata: configuration of the run, stored in the bag as JSON.
            namespace: namespace of the topics.
            topics: topics to be written.
            signals: signals of the trajectory that is written; None for a recording.

        Returns:
            The open writer.

        Raises:
            BadInput: the folder exists or cannot be created, or the storage is unknown.
            TypeError: the metadata cannot be expressed in JSON.
        """
        provenance = Provenance(as_json(metadata), {}, signals)
        if storage not in get_args(Storage):
            raise BadInput(f"storage is {storage!r}", str(path), f"one of {', '.join(get_args(Storage))}")
        if storage == "sqlite3" and set("?#%") & set(str(path)):
            # rosbags puts the path into a URI for SQLite without quoting it.
            raise BadInput("the path contains ?, # or %", str(path), "a path without them, or storage mcap")
        try:
            if path.exists():
                raise BadInput("the output exists already", str(path), NEW_FOLDER)
            writer = StorageWriter(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
            writer.open()
        except (OSError, sqlite3.Error) as error:
            where = getattr(error, "filename", None) or path
            raise BadInput(f"the output cannot be created ({reason(error)})", str(where), NEW_FOLDER) from None
        return cls(writer, topics, namespace, provenance)

    def add_topic(self, topic: Topic, defined: MessageDefinition | None = None) -> None:
        """Add a topic to those that can be written; no effect if it is already present.

        Args:
            topic: the topic.
            defined: definition of its type; None for a known type.

        Raises:
            rosbags.typesys.TypesysError: the definition is invalid.
        """
        if topic.name in self._connections:
            return
        store = typestore_of(defined, topic.type) if defined else typestore()
        connection = self._writer.add_connection(
            topic.resolve(self._namespace),
            topic.type,
            msgdef=defined.data if defined else definition(topic.type),
            rihs01=store.hash_rihs01(topic.type),
            offered_qos_profiles=[_offered(topic)],
        )
        self._storage.ledger.add_topic(connection.id, connection.topic)
        self._connections[topic.name] = connection

    def write(self, topic: str, stamp_ns: int, serialized: bytes) -> None:
        """Write one message.

        Args:
            topic: name of one of the bag's topics.
            stamp_ns: time of sending, not negative [ns].
            serialized: the message as CDR.

        Raises:
            OSError: the disk is full or fails; the bag has been abandoned.
        """
        if stamp_ns < 0:
            raise ValueError(f"stamp of a message on {topic} is {stamp_ns} ns; expected 0 or later")
        connection = self._connections[topic]
        self._storage.ledger.add(connection.id, stamp_ns, serialized)
        try:
            self._writer.write(connection, stamp_ns, serialized)
        except (OSError, sqlite3.Error) as error:
            self._abandon(error)

    def set_recovery(self, recovery: Mapping[str, Any]) -> None:
        """Record the losses of the damaged bag in the metadata.

        Args:
            recovery: JSON values.
        """
        self._provenance = self._provenance._replace(recovery=as_json(recovery))

    def flush(self) -> None:
        """Secure the written messages against a crash of this process, and update the note beside the bag.

        :func:`ehls_ros.recording.recovery.recover` can then restore the bag.

        Raises:
            OSError: the disk is full or fails; the bag has been abandoned and can be recovered up to the previous flush.
        """
        try:
            self._storage.flush()
            flushed = {path: Flushed(tally.messages, tally.newest_ns) for path, tally in self._storage.ledger.tallies().items()}
            write_note(self._writer.path, flushed)
        except (OSError, sqlite3.Error) as error:
            self._abandon(error)

    def close(self) -> None:
        """Write the remaining messages and the metadata; a second call does nothing.

        Raises:
            OSError: the disk is full or fails; the bag has been abandoned.
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
            self._abandon(error)
        self._open = False

    def abort(self) -> None:
        """Stop without metadata, so that the remains are not mistaken for a bag; closing then has no effect."""
        self._open = False
        try:
            self._writer.abort()
        except (OSError, sqlite3.Error):
            return  # the original error is more informative

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the bag."""
        self.close()

    def _abandon(self, error: OSError | sqlite3.Error) -> NoReturn:
        self.abort()
        written = sum(self._writer.counts.values())
        number = (isinstance(error, OSError) and error.errno) or (errno.ENOSPC if "full" in str(error) else errno.EIO)
        what = f"{reason(error)}; the bag is incomplete after {written} messages"
        raise OSError(number, what, str(self._writer.path)) from error


def _offered(topic: Topic) -> Qos:
    """Return the QoS of the topic's publishers, for `ros2 bag play` to offer."""
    none = QosTime(0, 0)
    durability = QosDurability.TRANSIENT_LOCAL if topic.transient_local else QosDurability.VOLATILE
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=topic.depth,
        reliability=QosReliability.RELIABLE,
        durability=durability,
        deadline=none,
        lifespan=none,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=none,
        avoid_ros_namespace_conventions=False,
    )


def write_trajectory(path: Path, trajectory: Trajectory, storage: Storage = "mcap") -> None:
    """Write a trajectory as a bag, in the form of a recording of the same run.

    Header stamps are the sample times rounded to nanoseconds; cycles count from 0. A message whose signals are all NaN is
    omitted.

    Args:
        path: folder to create.
        trajectory: trajectory to be written.
        storage: rosbag2 storage plugin.

    Raises:
        BadInput: the folder cannot be created, or messages cannot express the trajectory.
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
