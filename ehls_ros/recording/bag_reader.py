"""Reading of rosbag2: ours or of ROS's own recorder, whole or not at all."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.alignment import CYCLE, SENT, MessageColumns, align
from ehls_ros.recording.bag_topic import BLOCK, BagTopic
from ehls_ros.recording.deadline import Deadline
from ehls_ros.recording.expansion import Allowance, check_chunks, compression_mode, expanded_message, laid_open
from ehls_ros.recording.provenance import Provenance, provenance_in
from ehls_ros.recording.reason import reason
from ehls_ros.recording.recording_note import NOTE
from ehls_ros.recording.regular_file import check_regular, read_text
from ehls_ros.recording.storage_file import CLOSED_BAG, METADATA_FILE, custom_data_in, parse_metadata
from ehls_ros.recording.topics import CYCLE_TOPICS, LOADER_STATE
from ehls_ros.trajectory import SIGNALS, Trajectory

STORAGE_SUFFIXES = (".mcap", ".db3")


def read_bag(path: Path) -> Trajectory:
    """Read a rosbag2 made by the recorder node, by ``ros2 bag record`` or from a trajectory.

    The samples are the cycles of ``loader_state``, in whatever namespace. Messages of the other topics belong to the
    sample of their cycle, the first to arrive where there are several. A signal is NaN where its cycle has no message
    and absent where the whole bag has no value of it.

    Args:
        path: folder of the bag, or one storage file (``.mcap``, ``.db3``).

    Returns:
        The trajectory. Its times are the header stamps of the snapshots; those of a wall clock count from the first. Of a run
        in real time the metadata say as ``wall_s`` how long it took from the first snapshot to the last.

    Raises:
        BadInput: the bag is missing, cut, damaged, never closed, without ``loader_state``, of several runs, or
            expands beyond measure.
    """
    where = str(path)
    with ExitStack() as stack:
        with _damage_reported(where):
            metadata = _metadata(path)
            size = _size(path, metadata)
            allowance, deadline = Allowance(size), Deadline(size, where)
            bag = stack.enter_context(laid_open(path, metadata, allowance)) if metadata is not None else path
            custom_data = [_checked(file, allowance, deadline) for file in _storage_files(bag)]
        reader = stack.enter_context(closing(_open(bag)))
        compressed = metadata is not None and compression_mode(metadata) == "message"
        expand = partial(expanded_message, allowance=allowance, where=where) if compressed else None
        entries = reader.storage.metadata.custom
        provenance = _provenance([*custom_data, entries if isinstance(entries, dict) else {}], where)
        columns = _read_topics(reader, provenance, deadline, where, expand)
    if not len(columns[LOADER_STATE.name][CYCLE]):
        raise BadInput(f"there is no message of {LOADER_STATE.name}", where, "one snapshot or more")
    time_s, signals = align(columns, where)
    configuration = provenance.configuration if provenance else {}
    if configuration.get("timing") == "realtime":
        configuration = {"wall_s": float(np.ptp(columns[LOADER_STATE.name][SENT])) / 1e9, **configuration}
    return Trajectory(time_s, _recorded(signals, len(time_s), provenance), configuration)


def is_closed(folder: Path) -> bool:
    """Tell whether the recorder of a bag got to its end."""
    return (folder / METADATA_FILE).exists() and not (folder / NOTE).exists()


def _metadata(path: Path) -> Any:
    """Check that a bag is there and closed, and return what its metadata.yaml says; None for a single storage file."""
    if path.is_dir():
        if (path / NOTE).exists():
            raise BadInput("it is being recorded, or its recorder was killed", str(path), f"`ehls recover {path}` in that case")
        if not (path / METADATA_FILE).exists():
            raise BadInput(f"{METADATA_FILE} is missing", str(path), CLOSED_BAG)
        # rosbags parses it again, and trusts it
        return parse_metadata(read_text(path / METADATA_FILE, limits.TEXT, CLOSED_BAG), str(path / METADATA_FILE))
    if not path.exists():
        raise BadInput("it does not exist", str(path), "a folder of a rosbag2, or a file .mcap or .db3")
    if path.suffix not in STORAGE_SUFFIXES:
        raise BadInput("it is no bag", str(path), "a folder of a rosbag2, or a file .mcap or .db3")
    return None


def _storage_files(bag: Path) -> list[Path]:
    """Return the storage files of a folder, or the one that is a bag by itself."""
    return sorted(file for file in bag.iterdir() if file.suffix in STORAGE_SUFFIXES) if bag.is_dir() else [bag]


def _size(path: Path, metadata: Any) -> int:
    """Return what a bag's storage files take on disk [B]."""
    if metadata is None:
        return check_regular(path, limits.BAG, CLOSED_BAG, larger=limits.BAG_LARGER)
    names = [PurePath(name).name for name in metadata["rosbag2_bagfile_information"]["relative_file_paths"]]
    for name in names:
        # What is named otherwise, or twice, would be read unchecked, or again and again.
        if PurePath(name.removesuffix(".zstd")).suffix not in STORAGE_SUFFIXES or names.count(name) > 1:
            expected = f"files {' or '.join(STORAGE_SUFFIXES)}, each once"
            raise BadInput(f"it names the storage file {name!r}", str(path / METADATA_FILE), expected)
    files = {name: f"the storage file {name}" for name in names}
    return sum(check_regular(path / name, limits.BAG, CLOSED_BAG, what, limits.BAG_LARGER) for name, what in files.items())


def _checked(file: Path, allowance: Allowance, deadline: Deadline) -> Mapping[str, str]:
    """Check that a storage file is whole and does not expand beyond measure, and return the custom data it carries."""
    check_regular(file, limits.BAG, CLOSED_BAG)
    custom_data = custom_data_in(file, deadline)
    if file.suffix == ".mcap":
        check_chunks(file, allowance, deadline)
    return custom_data


@contextmanager
def _damage_reported(where: str) -> Iterator[None]:
    """Turn whatever rosbags stumbles over in a damaged bag, which can be any exception, into a bad input."""
    try:
        yield
    except BadInput:
        raise
    except Exception as error:
        raise BadInput(f"the bag cannot be read ({reason(error)})", where, CLOSED_BAG) from error


def _open(path: Path) -> Reader:
    with _damage_reported(str(path)):
        reader = Reader(path)
        reader.open()
        return reader


def _messages(
    reader: Reader, connections: Sequence[Connection], where: str, expand: Callable[[bytes], bytes] | None
) -> Iterator[tuple[Connection, int, bytes]]:
    with _damage_reported(where):
        for connection, stamp_ns, message in reader.messages(connections):
            yield connection, stamp_ns, expand(message) if expand else message


def _provenance(custom_data: Sequence[Mapping[str, str]], where: str) -> Provenance | None:
    """Return what the copies of the metadata agree on."""
    found = [provenance for entries in custom_data if (provenance := provenance_in(entries, where))]
    if any(provenance != found[0] for provenance in found):
        raise BadInput("its metadata are those of another bag", where, "a bag as it was written")
    return found[0] if found else None


def _read_topics(
    reader: Reader, provenance: Provenance | None, deadline: Deadline, where: str, expand: Callable[[bytes], bytes] | None
) -> dict[str, MessageColumns]:
    """Return the messages of the cycle topics the bag has, by the topic's name."""
    by_path: dict[str, list[Connection]] = defaultdict(list)
    for connection in reader.connections:
        if not isinstance(connection.topic, str):
            raise BadInput(f"a topic is named {connection.topic!r}", where, CLOSED_BAG)
        by_path[connection.topic].append(connection)
    namespace = _namespace(by_path, where)
    seals = provenance.seals if provenance else {}
    topics: list[BagTopic] = []
    sinks: dict[int, BagTopic] = {}
    for topic in CYCLE_TOPICS:
        name = topic.resolve(namespace)
        if name in by_path:
            with _damage_reported(where):
                topics.append(BagTopic(topic, by_path[name], seals.get(name), f"{where}, {name}"))
            sinks |= {connection.id: topics[-1] for connection in by_path[name]}
        if (name in by_path) != (name in seals) and provenance:
            raise BadInput(f"topic {name} was not recorded with the others", where, "a bag as it was written")
    connections = [connection for connection in reader.connections if connection.id in sinks]
    for number, (connection, stamp_ns, message) in enumerate(_messages(reader, connections, where, expand)):
        if number % BLOCK == 0:
            deadline.check()
        sinks[connection.id].add(stamp_ns, message)
    return {topic.topic.name: topic.columns() for topic in topics}


def _namespace(by_path: Mapping[str, Sequence[Connection]], where: str) -> str:
    """Return the one namespace that has a ``loader_state``."""
    ending = f"/{LOADER_STATE.name}"
    namespaces = [path.removesuffix(ending) for path in by_path if path.endswith(ending)]
    if not namespaces:
        found = ", ".join(sorted(by_path)) or "none"
        raise BadInput(f"topic {LOADER_STATE.name} is missing among {found}", where, f"a topic of {LOADER_STATE.type}")
    if len(namespaces) > 1:
        raise BadInput(f"it holds several rigs: {', '.join(sorted(namespaces))}", where, "one rig a bag")
    return namespaces[0]


def _recorded(
    signals: Mapping[str, NDArray[np.float64]], samples: int, provenance: Provenance | None
) -> dict[str, NDArray[np.float64]]:
    """Return the signals somebody measured, in the order of the data contract."""
    if provenance is not None and provenance.signals is not None:
        return {name: signals.get(name, np.full(samples, np.nan)) for name in SIGNALS if name in provenance.signals}
    return {name: signals[name] for name in SIGNALS if name in signals and not np.isnan(signals[name]).all()}
