"""Bags as other tools leave them: profiles, types, encodings and messages beyond those of `ros2 bag record`."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import Message, definition_of, record, serialized, storage_file
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import load
from ehls_ros.recording.proposal import look, proposed_map
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.typestore import typestore
from ehls_ros.trajectory import Trajectory

MAP = ColumnMap({"position_m": Column("data", table="/p")})
NUMBER, WHOLE = "std_msgs/msg/Float64", "std_msgs/msg/Int64"


def number(k: int, topic: str = "/p") -> Message:
    return Message(topic, NUMBER, k * 10**6, {"data": float(k)})


def numbers(folder: Path, storage: str = "mcap", count: int = 30, **more: CompressionMode) -> Path:
    return record(folder / "bag", [number(k) for k in range(count)], storage, **more)


def raw_bag(folder: Path, storage: str, types: list[str], messages: list[bytes]) -> Path:
    """Return a bag with a message every millisecond on /p, of the types in turn."""
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        store = typestore()
        topics = [writer.add_connection("/p", t, msgdef=definition_of(t), rihs01=store.hash_rihs01(t)) for t in types]
        for k, message in enumerate(messages):
            writer.write(topics[k % len(types)], k * 10**6, message)
    return folder / "bag"


def read(bag: Path) -> Trajectory:
    return load(bag, MAP)


def refused(bag: Path) -> str:
    with pytest.raises(BadInput) as error:
        read(bag)
    return str(error.value)


def replaced(bag: Path, old: bytes, new: bytes) -> Path:
    file = storage_file(bag)
    content = file.read_bytes()
    assert old in content
    file.write_bytes(content.replace(old, new))
    return bag


@pytest.mark.parametrize("profile", ["- reliability: reliable\n  depth: 5", "- : [", "junk"])
def test_incomplete_profiles_do_not_matter(tmp_path: Path, profile: str):
    """A writer of rosbag2_py may set any text."""
    bag = numbers(tmp_path, "sqlite3")
    with closing(sqlite3.connect(storage_file(bag))) as database, database:
        database.execute("UPDATE topics SET offered_qos_profiles = ?", (profile,))
    assert len(read(bag)) == 30


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_topic_of_several_types_is_refused(tmp_path: Path, storage: str):
    """Float64 and Int64 have messages of one length, which would be read as the first type."""
    messages = [serialized(Message("/p", t, 0, {"data": v})) for t, v in ((NUMBER, 1.0), (WHOLE, 2))] * 10
    bag = raw_bag(tmp_path, storage, [NUMBER, WHOLE], messages)
    for path in (bag, storage_file(bag)):
        text = refused(path)
        assert "/p: its messages are of several types: std_msgs/msg/Float64, std_msgs/msg/Int64; expected one type per" in text


def test_empty_messages_are_left_out_with_their_number(tmp_path: Path):
    messages = [b"" if k in (3, 7) else serialized(number(k)) for k in range(20)]
    found = read(raw_bag(tmp_path, "mcap", [NUMBER], messages))
    assert found["position_m"].tolist() == [float(k) for k in range(20) if k not in (3, 7)]
    assert "position_m: 2 messages are empty and left out" in found.preparation.remarks


def test_a_message_without_content_but_a_header_is_refused(tmp_path: Path):
    messages = [serialized(number(k)) if k else b"\0\1\0\0" for k in range(20)]
    assert "/p: message has 4 bytes where its fields need 12" in refused(raw_bag(tmp_path, "mcap", [NUMBER], messages))


def test_an_empty_bag_and_an_empty_topic_are_named(tmp_path: Path):
    empty = record(tmp_path / "empty", [])
    with pytest.raises(BadInput, match=r"no topic has numbers \(it has no topic\)"):
        look(empty)
    silent = raw_bag(tmp_path, "mcap", [NUMBER], [])
    with pytest.raises(BadInput, match=r"no topic has numbers \(/p: it has no message\)"):
        look(silent)
    assert "/p: there is no message" in refused(silent)


def test_files_of_other_systems_are_named(tmp_path: Path):
    assert "its profile is 'ros1'; expected a file of ROS 2" in refused(
        replaced(numbers(tmp_path / "1"), b"\4\0\0\0ros2", b"\4\0\0\0ros1")
    )
    assert "/p: its messages are serialized as jsn; expected cdr" in refused(
        replaced(numbers(tmp_path / "2"), b"\3\0\0\0cdr", b"\3\0\0\0jsn")
    )
    assert "type std_msgs/msg/Float64 is defined as ros9msg; expected types of ROS 2" in refused(
        replaced(numbers(tmp_path / "3"), b"ros2msg", b"ros9msg")
    )


def test_left_out_topics_are_named_with_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    texts = [Message("/log", "std_msgs/msg/String", k, {"data": "a"}) for k in range(3)]
    bag = record(tmp_path / "bag", [*(number(k) for k in range(3)), *texts])
    [_, log] = look(bag)
    assert log.remarks == ("left out: type std_msgs/msg/String has no number",)
    assert "# --- /log\n# left out: type std_msgs/msg/String has no number\n" in proposed_map([log, *look(bag)]).text
    assert main(["columns", str(bag)]) == 0
    assert "/log: left out: type std_msgs/msg/String has no number" in capsys.readouterr().err


def test_a_type_without_definition_is_named_with_the_remedy(tmp_path: Path):
    bag = replaced(numbers(tmp_path, "sqlite3"), NUMBER.encode(), b"our_msgs/msg/Float64")
    with closing(sqlite3.connect(storage_file(bag))) as database, database:
        database.execute("DELETE FROM message_definitions")
    assert "/p: type our_msgs/msg/Float64 is not defined; expected its definition in the bag: `ros2 bag convert`" in refused(
        storage_file(bag)
    )


@pytest.mark.parametrize(
    ("storage", "compression"),
    [("mcap", CompressionMode.NONE), ("mcap", CompressionMode.STORAGE), ("sqlite3", CompressionMode.NONE)],
)
def test_a_bag_cut_by_a_loss_of_power_is_recovered(tmp_path: Path, storage: str, compression: CompressionMode):
    random = np.random.default_rng(1)
    layout = typestore().types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    rows = [{"layout": layout, "data": np.concatenate([[k], random.normal(size=500)])} for k in range(600)]
    messages = [Message("/p", "std_msgs/msg/Float64MultiArray", k * 10**6, fields) for k, fields in enumerate(rows)]
    bag = record(tmp_path / "bag", messages, storage, compression=compression)
    file = storage_file(bag)
    file.write_bytes(file.read_bytes()[: int(0.7 * file.stat().st_size)])
    (bag / "metadata.yaml").unlink()
    assert f"`ehls recover {file}` saves the sound messages" in refused(bag)
    recovery = recover(bag, tmp_path / "recovered")
    found = load(tmp_path / "recovered", ColumnMap({"position_m": Column("data[0]", table="/p")}))
    assert len(found) == recovery.recovered > 200
    assert np.all(np.diff(found["position_m"]) > 0.0)


def test_a_recovery_without_a_known_type_is_refused(tmp_path: Path):
    bag = replaced(numbers(tmp_path, "sqlite3"), NUMBER.encode(), b"our_msgs/msg/Float64")
    with pytest.raises(BadInput, match="no topic loader_state is left in it"):
        recover(bag, tmp_path / "recovered")
