import errno
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from full_disk import no_file_larger_than
from recorded_runs import (
    METADATA,
    Message,
    folder_for_nobody,
    loader_state,
    make_trajectory,
    serialized,
    storage_file,
    valve_command,
)
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import BagWriter, Storage, write_trajectory
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.topics import TOPICS, transition_topic
from ehls_ros.recording.typestore import typestore

STORAGES: list[Storage] = ["mcap", "sqlite3"]


def write(writer: BagWriter, message: Message) -> None:
    writer.write(message.topic.rpartition("/")[2], message.received_ns, serialized(message))


@pytest.fixture
def write_protected() -> Iterator[Path]:
    """Yield a folder in which this process cannot write, even as root."""
    with folder_for_nobody(0o555) as folder:
        yield folder


@pytest.mark.parametrize("storage", STORAGES)
def test_every_message_is_in_the_bag_with_its_time(tmp_path: Path, storage: Storage):
    commands = 20_000
    command = serialized(valve_command(0))
    with BagWriter.create(tmp_path / "bag", storage) as writer:
        write(writer, loader_state(0))
        for stamp_ns in range(commands):
            writer.write("valve_command", stamp_ns, command)
        writer.write("/diagnostics", 5, b"\x00\x01\x00\x00 as it came")
    with Reader(tmp_path / "bag") as reader:
        assert {connection.topic: connection.msgtype for connection in reader.connections} == {
            topic.resolve(): topic.type for topic in TOPICS
        }
        messages = [(connection.topic, stamp_ns, data) for connection, stamp_ns, data in reader.messages()]
    assert [stamp_ns for topic, stamp_ns, _ in messages if topic == "/ehls/valve_command"] == list(range(commands))
    assert all(data == command for topic, _, data in messages if topic == "/ehls/valve_command")
    assert ("/diagnostics", 5, b"\x00\x01\x00\x00 as it came") in messages
    assert len(messages) == commands + 2


@pytest.mark.parametrize("storage", STORAGES)
def test_the_configuration_is_in_the_metadata_as_json(tmp_path: Path, storage: Storage):
    BagWriter.create(tmp_path / "bag", storage, METADATA).close()
    content = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8"))
    custom_data = content["rosbag2_bagfile_information"]["custom_data"]
    assert json.loads(custom_data["ehls_ros"])["configuration"] == METADATA


def profiles(topic: str, bag: Path) -> list[tuple[str, int, str, str]]:
    """Return the publisher profiles of a topic in metadata.yaml and in the storage, after checking that they agree."""
    content = yaml.safe_load((bag / "metadata.yaml").read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    (entry,) = (t["topic_metadata"] for t in content["topics_with_message_count"] if t["topic_metadata"]["name"] == topic)
    offered = entry["offered_qos_profiles"]
    with Reader(bag) as reader:
        stored = [q for c in reader.connections if c.topic == topic for q in c.ext.offered_qos_profiles]
    assert [(q.depth, q.durability.name.lower()) for q in stored] == [(o["depth"], o["durability"]) for o in offered]
    return [(o["history"], o["depth"], o["reliability"], o["durability"]) for o in offered]


@pytest.mark.parametrize("storage", STORAGES)
def test_profiles_and_units_are_in_the_bag_and_in_a_recovered_one(tmp_path: Path, storage: Storage):
    with BagWriter.create(tmp_path / "bag", storage) as writer:
        write(writer, loader_state(0))
        writer.add_topic(transition_topic("sic_node"))
        writer.write(transition_topic("sic_node").name, 1, serialized_transition())
    recover(tmp_path / "bag", tmp_path / "whole")
    for bag in (tmp_path / "bag", tmp_path / "whole"):
        assert profiles("/ehls/loader_state", bag) == [("keep_last", 1000, "reliable", "transient_local")]
        assert profiles("/diagnostics", bag) == [("keep_last", 10, "reliable", "volatile")]
        assert profiles("/ehls/sic_node/transition_event", bag) == [("keep_last", 10, "reliable", "volatile")]
        with Reader(bag) as reader:
            (definition,) = (c.msgdef.data for c in reader.connections if c.topic == "/ehls/loader_state")
        assert "load_pressure     # load pressure pL = p1 - p2 [Pa]" in definition
        # Complete without ROS: the types it uses follow.
        assert get_types_from_msg(definition, "ehls_msgs/msg/LoaderState").keys() == {
            "ehls_msgs/msg/LoaderState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time",
        }  # fmt: skip


def serialized_transition() -> bytes:
    kinds = typestore().types
    state = kinds["lifecycle_msgs/msg/State"](id=1, label="unconfigured")
    moved = kinds["lifecycle_msgs/msg/Transition"](id=1, label="configure")
    event = kinds["lifecycle_msgs/msg/TransitionEvent"](timestamp=0, transition=moved, start_state=state, goal_state=state)
    return bytes(typestore().serialize_cdr(event, "lifecycle_msgs/msg/TransitionEvent"))


def test_topics_are_below_the_namespace(tmp_path: Path):
    with BagWriter.create(tmp_path / "bag", namespace="/rig7/ehls") as writer:
        write(writer, loader_state(0, force=2.0))
    assert read_bag(tmp_path / "bag")["force_n"].tolist() == [2.0]
    with Reader(tmp_path / "bag") as reader:
        assert "/rig7/ehls/loader_state" in reader.topics
        assert "/diagnostics" in reader.topics


def test_what_was_recorded_before_an_exception_is_kept(tmp_path: Path):
    def interrupted() -> None:
        with BagWriter.create(tmp_path / "bag") as writer:
            write(writer, loader_state(3, force=7.0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert read_bag(tmp_path / "bag")["force_n"].tolist() == [7.0]


def test_closing_twice_is_closing_once(tmp_path: Path):
    with BagWriter.create(tmp_path / "bag") as writer:
        write(writer, loader_state(0))
        writer.close()
    assert len(read_bag(tmp_path / "bag")) == 1


@pytest.mark.parametrize("storage", STORAGES)
def test_an_aborted_bag_is_not_readable(tmp_path: Path, storage: Storage):
    with BagWriter.create(tmp_path / "bag", storage) as writer:
        write(writer, loader_state(0))
        writer.abort()
    for path in (tmp_path / "bag", storage_file(tmp_path / "bag")):
        with pytest.raises(BadInput):
            read_bag(path)


def test_a_stamp_before_the_epoch_leaves_the_bag_as_it_was(tmp_path: Path):
    with BagWriter.create(tmp_path / "bag") as writer:
        write(writer, loader_state(0))
        with pytest.raises(ValueError, match="loader_state is -1 ns"):
            writer.write("loader_state", -1, serialized(loader_state(1)))
    assert len(read_bag(tmp_path / "bag")) == 1


@pytest.mark.parametrize("storage", STORAGES)
def test_a_full_disk_is_reported_and_leaves_no_bag(tmp_path: Path, storage: Storage):
    message = serialized(loader_state(0))

    def fill() -> None:
        with BagWriter.create(tmp_path / "bag", storage) as writer:
            for stamp_ns in range(30_000):
                writer.write("loader_state", stamp_ns, message)

    with no_file_larger_than(200_000), pytest.raises(OSError, match="the bag is incomplete after") as caught:
        fill()
    assert caught.value.filename == str(tmp_path / "bag")
    assert caught.value.errno in {errno.EFBIG, errno.EIO, errno.ENOSPC}
    with pytest.raises(BadInput, match=r"the file (is truncated or still being written|was never closed)"):
        read_bag(tmp_path / "bag")


@pytest.mark.parametrize("storage", STORAGES)
def test_a_disk_that_is_full_at_the_end_is_reported_too(tmp_path: Path, storage: Storage):
    with no_file_larger_than(100_000), pytest.raises(OSError, match="the bag is incomplete after"):
        write_trajectory(tmp_path / "bag", make_trajectory(300), storage)
    with pytest.raises(BadInput, match=r"the file (is truncated or still being written|was never closed)"):
        read_bag(tmp_path / "bag")


@pytest.mark.parametrize("storage", STORAGES)
def test_an_output_without_write_permission_is_bad_input(write_protected: Path, storage: Storage):
    with pytest.raises(BadInput, match="Permission denied") as caught:
        BagWriter.create(write_protected / "runs" / "bag", storage)
    assert caught.value.where == str(write_protected / "runs")
    assert caught.value.expected == "a new folder in a writable place"


def a_folder(path: Path) -> Path:
    path.mkdir()
    return path


def a_file(path: Path) -> Path:
    path.touch()
    return path


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (a_folder, "the output exists already"),
        (a_file, "the output exists already"),
        (lambda path: a_file(path) / "bag", "Not a directory"),
        (lambda path: path / ("x" * 300), "File name too long"),
    ],
)
def test_an_output_that_cannot_be_created_is_bad_input(tmp_path: Path, make: Callable[[Path], Path], complaint: str):
    with pytest.raises(BadInput, match=complaint):
        BagWriter.create(make(tmp_path / "there"))


def test_an_unknown_storage_is_bad_input(tmp_path: Path):
    with pytest.raises(BadInput, match="storage is 'hdf5'; expected one of mcap, sqlite3"):
        BagWriter.create(tmp_path / "bag", "hdf5")


@pytest.mark.parametrize("name", ["run#1", "run?", "50%25"])
def test_a_path_that_sqlite_would_misread_is_bad_input(tmp_path: Path, name: str):
    with pytest.raises(BadInput, match="the path contains"):
        BagWriter.create(tmp_path / name, "sqlite3")
    assert not list(tmp_path.iterdir())
    write_trajectory(tmp_path / name, make_trajectory(1))
    assert len(read_bag(tmp_path / name)) == 1


def test_metadata_without_json_form_stop_the_recording_before_it_starts(tmp_path: Path):
    with pytest.raises(TypeError, match="is not a JSON value"):
        BagWriter.create(tmp_path / "bag", metadata={"rig": object()})
    assert not list(tmp_path.iterdir())
