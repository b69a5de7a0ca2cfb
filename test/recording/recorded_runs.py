"""Runs to record, and bags in the form of other recorders."""

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys.store import Typestore

from ehls_ros.recording.typestore import MESSAGE_FILES, typestore
from ehls_ros.trajectory import SIGNALS, Trajectory

METADATA = {"rig": {"moving_mass": 70.5, "note": "a 'quoted':  text\nwith lines é"}, "seed": [1, 2.5, None, True]}


def make_trajectory(samples: int = 20, *, start_s: float = 0.0) -> Trajectory:
    """Return a trajectory of 1 ms samples with noise in every signal."""
    random = np.random.default_rng(1)
    signals = {name: random.normal(size=samples) for name in SIGNALS}
    signals["friction_elements_n"] = random.normal(size=(samples, 4))
    signals["friction_slipping"] = random.integers(0, 2, (samples, 4)).astype(float)
    signals["saturated"] = random.integers(0, 2, samples).astype(float)
    signals["at_bound"] = random.integers(0, 2, samples).astype(float)
    signals["friction_fallback"] = random.integers(0, 2, samples).astype(float)
    for name in ("programme_block", "programme_repetition", "programme_load_cycles", "programme_state"):
        signals[name] = random.integers(0, 5, samples).astype(float)
    signals["response_s"] = random.integers(0, 10**6, samples) / 1e9
    stamps_ns = round(start_s * 1e9) + 10**6 * np.arange(samples)
    return Trajectory(stamps_ns / 1e9, signals, METADATA)


def same(first: Trajectory, second: Trajectory) -> bool:
    """Return whether two trajectories are bitwise equal."""
    return (
        list(first.signals) == list(second.signals)
        and first.time_s.tobytes() == second.time_s.tobytes()
        and all(first[name].shape == second[name].shape for name in first.signals)
        and all(first[name].tobytes() == second[name].tobytes() for name in first.signals)
        and first.metadata == second.metadata
    )


def storage_file(bag: Path) -> Path:
    """Return the only storage file in a bag's folder."""
    (file,) = (file for file in bag.iterdir() if file.suffix in {".mcap", ".db3"})
    return file


@contextmanager
def folder_for_nobody(mode: int) -> Iterator[Path]:
    """Yield an empty folder whose mode applies to this process even if it runs as root."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(mode)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield folder
    finally:
        os.seteuid(user)
        folder.rmdir()


class Message(NamedTuple):
    """A message before serialization; omitted fields are 0 or empty."""

    topic: str
    type: str
    received_ns: int
    fields: dict[str, Any]


def message(topic: str, type_name: str, cycle: int, stamp_ns: int, received_ns: int, fields: dict[str, Any]) -> Message:
    """Return a message of ehls_msgs."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    types = typestore().types
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="somewhere")
    return Message(topic, f"ehls_msgs/msg/{type_name}", received_ns, {"header": header, "cycle": cycle, **fields})


def loader_state(cycle: int, topic: str = "/ehls/loader_state", stamp_ns: int | None = None, **fields: Any) -> Message:
    """Return a snapshot, received when it was taken; cycles are 1 ms apart unless a stamp is given."""
    stamp_ns = cycle * 10**6 if stamp_ns is None else stamp_ns
    return message(topic, "LoaderState", cycle, stamp_ns, stamp_ns, fields)


def valve_command(cycle: int, topic: str = "/ehls/valve_command", delay_ns: int = 0, **fields: Any) -> Message:
    """Return a valve command, received a delay after the snapshot it answers."""
    return message(topic, "ValveCommand", cycle, cycle * 10**6, cycle * 10**6 + delay_ns, fields)


def serialized(message: Message, store: Typestore | None = None) -> bytes:
    """Serialize a message with rosbags, as the types of a store; by default those of ehls_msgs."""
    store = store or typestore()
    texts = (Nodetype.BASE, ("string", 0))
    kinds = dict(store.fielddefs[message.type][1])
    empty = {name: "" if kind == texts else np.zeros(0) if kind[0] is Nodetype.SEQUENCE else 0 for name, kind in kinds.items()}
    content = store.types[message.type](**{**empty, **message.fields})
    return bytes(store.serialize_cdr(content, message.type))


def definition_of(type_name: str) -> str:
    """Return a definition as ROS's recorder stores it: the file with its comments, then the types it uses."""
    package, _, name = type_name.split("/")
    if package != "ehls_msgs":
        return typestore().generate_msgdef(type_name, ros_version=2)[0]
    line = "=" * 80 + "\n"
    return (
        (MESSAGE_FILES / f"{name}.msg").read_text(encoding="utf-8")
        + f"{line}MSG: std_msgs/Header\n# comment\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        + f"{line}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )


def record(
    path: Path,
    messages: Iterable[Message],
    storage: str = "mcap",
    definitions: Mapping[str, tuple[str, str]] = MappingProxyType({}),
    compression: CompressionMode = CompressionMode.NONE,
    store: Typestore | None = None,
) -> Path:
    """Record messages with plain rosbags, as another recorder would.

    Args:
        path: folder to create.
        messages: in order of recording.
        storage: storage plugin.
        definitions: text and hash by type, if they differ from those of ehls_msgs.
        compression: what is compressed.
        store: types of the messages, if they differ from those of ehls_msgs.
    """
    store = store or typestore()
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, type_name, received_ns, fields in messages:
            if topic not in connections:
                known = definitions.get(type_name)
                definition, type_hash = known or (definition_of(type_name), store.hash_rihs01(type_name))
                connections[topic] = writer.add_connection(topic, type_name, msgdef=definition, rihs01=type_hash)
            writer.write(connections[topic], received_ns, serialized(Message(topic, type_name, received_ns, fields), store))
    return path
