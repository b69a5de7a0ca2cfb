"""Reading of rosbag2 from the recorder of this package or of ROS: completely or not at all."""

import shlex
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording import limits
from ehls_ros.recording.alignment import CYCLE, SENT, MessageColumns, align
from ehls_ros.recording.bag_files import BagFiles, contents_of, is_storage, opened_file
from ehls_ros.recording.bag_topic import BLOCK, BagTopic, cycle_topic
from ehls_ros.recording.expansion import Allowance, check_chunks, expanded_files, expanded_message
from ehls_ros.recording.limits import Deadline
from ehls_ros.recording.provenance import Provenance, Seal, provenance_in
from ehls_ros.recording.recording_note import NOTE
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.recording.storage_file import CLOSED_BAG, METADATA_FILE, custom_data_in
from ehls_ros.recording.topics import CYCLE_TOPICS, LOADER_STATE
from ehls_ros.trajectory import SIGNALS, Preparation, Trajectory


def read_bag(path: Path, wanted: Collection[str] = SIGNALS) -> Trajectory:
    """Read a rosbag2 made by the recorder node, by ``ros2 bag record`` or from a trajectory.

    The samples are the cycles of ``loader_state``, in any namespace. Messages on the other topics belong to the sample of their
    cycle; of several for one cycle, the first to arrive is used. A signal is NaN where its cycle has no message, and absent if
    the bag has no value of it.

    Args:
        path: folder of the bag, or one storage file (``.mcap``, ``.db3``).
        wanted: names of the signals to read; topics without any of them are skipped.

    Returns:
        The trajectory. Its times are the header stamps of the snapshots, relative to the first if they are wall-clock times.
        For a realtime run the metadata contain ``wall_s``, the time from the first snapshot to the last.

    Raises:
        BadInput: the bag is missing, truncated, damaged, unclosed, without ``loader_state``, of several runs, or too large when
            expanded.
    """
    where = str(path)
    with opened(path) as bag:
        provenance, remarks, columns = bag.provenance, bag.remarks, read_topics(bag, wanted)
    if not len(columns[LOADER_STATE.name][CYCLE]):
        raise BadInput(f"there is no message on {LOADER_STATE.name}", where, "at least one snapshot")
    time_s, signals = align(columns, where)
    configuration = provenance.configuration if provenance else {}
    if configuration.get("timing") == "realtime":
        configuration = {"wall_s": float(np.ptp(columns[LOADER_STATE.name][SENT])) / 1e9, **configuration}
    recorded = _recorded(signals, len(time_s), provenance)
    signals = {name: values for name, values in recorded.items() if name in wanted}
    return Trajectory(time_s, signals, configuration, preparation=Preparation(remarks))


class OpenBag(NamedTuple):
    """An open bag whose files are complete and within the size limits when expanded.

    Attributes:
        where: its path, for errors.
        reader: the reader of its messages.
        provenance: the provenance written by its recorder; None for another recorder.
        deadline: time limit of the reading.
        expand: function that expands a message if it is compressed.
        remarks: remarks on its files, one sentence each.
    """

    where: str
    reader: BagFiles
    provenance: Provenance | None
    deadline: Deadline
    expand: Callable[[bytes], bytes]
    remarks: tuple[str, ...]

    def by_topic(self) -> dict[str, list[Connection]]:
        """Return the bag's entries by the topic's full name.

        Raises:
            BadInput: a name is not a text.
        """
        found: dict[str, list[Connection]] = defaultdict(list)
        for connection in self.reader.connections:
            if not isinstance(connection.topic, str):
                raise BadInput(f"a topic is named {connection.topic!r}", self.where, CLOSED_BAG)
            found[connection.topic].append(connection)
        return found

    def seal(self, topic: str) -> Seal | None:
        """Return a topic's state when the bag was closed, if known."""
        return self.provenance.seals.get(topic) if self.provenance else None

    def read(self, sinks: Mapping[int, BagTopic], *, as_written: bool = False) -> None:
        """Pass each message to the sink of its connection's number; those without a sink are skipped.

        Args:
            sinks: by the connection's number.
            as_written: pass the messages in the order of writing instead of the order of their times.

        Raises:
            BadInput: the bag is damaged, or a message is not of its type.
        """
        connections = [connection for connection in self.reader.connections if connection.id in sinks]
        for number, (connection, stamp_ns, message) in enumerate(self.messages(connections, as_written=as_written)):
            if number % BLOCK == 0:
                self.deadline.check()
            sinks[connection.id].add(stamp_ns, message)

    def messages(
        self, connections: Sequence[Connection], *, as_written: bool = False
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Return each message of some connections with its time of sending [ns]; arguments as of :meth:`read`.

        Raises:
            BadInput: the bag is damaged.
        """
        with damage_reported(self.where):
            for connection, stamp_ns, message in self.reader.messages(connections, as_written=as_written):
                yield connection, stamp_ns, self.expand(message)


@contextmanager
def opened(path: Path) -> Iterator[OpenBag]:
    """Open a bag after checking its files.

    Args:
        path: folder of the bag, or one storage file.

    Yields:
        The bag.

    Raises:
        BadInput: the bag is missing, truncated, damaged, unclosed, or too large when expanded.
    """
    where = str(path)
    with _recoverable(path), ExitStack() as stack:
        with damage_reported(where):
            contents = contents_of(path)
            sizes = [
                check_regular(f, limits.BAG, CLOSED_BAG, f"the storage file {f.name}", limits.BAG_LARGER)
                for f in contents.files
            ]
            allowance, deadline = Allowance(sum(sizes)), Deadline(sum(sizes), where)
            files = stack.enter_context(expanded_files(contents.files, allowance))
            custom_data = [_checked(file, allowance, deadline) for file in files]
            readers = [stack.enter_context(opened_file(file)) for file in files]
            bag = BagFiles(readers, contents, where)
        entries = contents.information.get("custom_data") if contents.information else None
        provenance = _provenance([*custom_data, entries if isinstance(entries, dict) else {}], where)
        yield OpenBag(
            where, bag, provenance, deadline, partial(expanded_message, allowance=allowance, where=where), contents.remarks
        )


@contextmanager
def _recoverable(path: Path) -> Iterator[None]:
    """Name the command that saves the rest of a damaged bag."""
    try:
        yield
    except BadInput as error:
        if error.expected != CLOSED_BAG:
            raise
        damaged = error.where if is_storage(error.where) else str(path)
        expected = f"{CLOSED_BAG}; `ehls recover {shlex.quote(damaged)}` saves the sound messages"
        raise BadInput(error.what, error.where, expected) from error


def is_closed(folder: Path) -> bool:
    """Return whether the recorder closed a bag."""
    return (folder / METADATA_FILE).exists() and not (folder / NOTE).exists()


def _checked(file: Path, allowance: Allowance, deadline: Deadline) -> Mapping[str, str]:
    """Check that a storage file is complete and within the size limits when expanded, and return its custom data."""
    check_regular(file, limits.BAG, CLOSED_BAG)
    custom_data = custom_data_in(file, deadline)
    if file.suffix == ".mcap":
        check_chunks(file, allowance, deadline)
    return custom_data


@contextmanager
def damage_reported(where: str) -> Iterator[None]:
    """Convert exceptions of rosbags, which may be of any kind on a damaged bag, to BadInput."""
    try:
        yield
    except BadInput:
        raise
    except Exception as error:
        raise BadInput(f"the bag cannot be read ({reason(error)})", where, CLOSED_BAG) from error


def _provenance(custom_data: Sequence[Mapping[str, str]], where: str) -> Provenance | None:
    """Return the provenance after a check that all copies of the metadata agree."""
    found = [provenance for entries in custom_data if (provenance := provenance_in(entries, where))]
    if any(provenance != found[0] for provenance in found):
        raise BadInput("its metadata are those of another bag", where, "an unaltered bag")
    return found[0] if found else None


def read_topics(bag: OpenBag, wanted: Collection[str]) -> dict[str, MessageColumns]:
    """Read ``loader_state`` and the cycle topics with wanted signals, by topic name."""
    by_path, namespace = bag.by_topic(), namespace_of(bag)
    topics: dict[str, BagTopic] = {}
    sinks: dict[int, BagTopic] = {}
    for topic in CYCLE_TOPICS:
        name, seal = topic.resolve(namespace), bag.seal(topic.resolve(namespace))
        if name in by_path and (topic is LOADER_STATE or not set(wanted).isdisjoint(topic.signals.values())):
            with damage_reported(bag.where):
                topics[topic.name] = cycle_topic(topic, by_path[name], seal, f"{bag.where}, {name}")
            sinks |= {connection.id: topics[topic.name] for connection in by_path[name]}
        if bag.provenance and (name in by_path) != (seal is not None):
            raise BadInput(f"topic {name} was not recorded with the others", bag.where, "an unaltered bag")
    bag.read(sinks)
    return {name: topic.columns() for name, topic in topics.items()}


def namespace_of(bag: OpenBag) -> str:
    """Return the only namespace with a ``loader_state``.

    Raises:
        BadInput: there is none, or there are several.
    """
    by_path, where = bag.by_topic(), bag.where
    ending = f"/{LOADER_STATE.name}"
    namespaces = [path.removesuffix(ending) for path in by_path if path.endswith(ending)]
    if not namespaces:
        found = ", ".join(sorted(by_path)) or "none"
        expected = f"a topic of {LOADER_STATE.type}, or a map of columns that names topics (ehls columns {shlex.quote(where)})"
        raise BadInput(f"topic {LOADER_STATE.name} is missing (found: {found})", where, expected)
    if len(namespaces) > 1:
        raise BadInput(f"it contains several rigs: {', '.join(sorted(namespaces))}", where, "one rig per bag")
    return namespaces[0]


def _recorded(
    signals: Mapping[str, NDArray[np.float64]], samples: int, provenance: Provenance | None
) -> dict[str, NDArray[np.float64]]:
    """Return the recorded signals, in the order of the data contract."""
    if provenance is not None and provenance.signals is not None:
        return {name: signals.get(name, np.full(samples, np.nan)) for name in SIGNALS if name in provenance.signals}
    return {name: signals[name] for name in SIGNALS if name in signals and not np.isnan(signals[name]).all()}
