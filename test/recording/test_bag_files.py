"""The files of a bag: split, without metadata, renamed, compressed or expanded by hand, indexed anew."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from recorded_runs import Message, loader_state, record, storage_file
from rosbags.rosbag2 import CompressionMode, storage_mcap

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import load

zstd = storage_mcap.zstd


def part(folder: Path, cycles: range, storage: str = "mcap", shift_ns: int = 0) -> Path:
    """Return the file of a bag with some cycles of 1 ms."""
    states = [loader_state(k, stamp_ns=k * 10**6 + shift_ns, force=float(k)) for k in cycles]
    return storage_file(record(folder, states, storage))


def together(folder: Path, **parts: Path) -> Path:
    """Move files into one folder, under new names."""
    folder.mkdir()
    for name, file in parts.items():
        file.rename(folder / f"{name}{file.suffix}")
    return folder


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_files_without_metadata_are_read_in_the_order_of_their_numbers(tmp_path: Path, storage: str):
    parts = {f"run_{k}": part(tmp_path / f"p{k}", range(10 * k, 10 * k + 10), storage) for k in range(12)}
    read = read_bag(together(tmp_path / "bag", **parts))
    assert read["force_n"].tolist() == list(range(120))
    assert "metadata.yaml is missing: run_0." in read.preparation.remarks[0]


def test_a_missing_number_is_a_remark(tmp_path: Path):
    parts = {f"run_{k}": part(tmp_path / f"p{k}", range(10 * k, 10 * k + 10)) for k in (0, 2, 3)}
    [remark] = read_bag(together(tmp_path / "bag", **parts)).preparation.remarks
    assert remark.endswith("; there is no file of number 1")


def test_files_of_other_names_are_read_in_the_order_of_their_times(tmp_path: Path):
    bag = together(tmp_path / "bag", b=part(tmp_path / "p0", range(10)), a=part(tmp_path / "p1", range(10, 20)))
    assert read_bag(bag)["force_n"].tolist() == list(range(20))


def test_topics_of_a_map_are_read_from_several_files(tmp_path: Path):
    def numbers(folder: Path, begin: int) -> Path:
        messages = [Message("/p", "std_msgs/msg/Float64", 10**6 * k, {"data": float(k)}) for k in range(begin, begin + 50)]
        return storage_file(record(folder, messages))

    bag = together(tmp_path / "bag", run_0=numbers(tmp_path / "p0", 0), run_1=numbers(tmp_path / "p1", 50))
    read = load(bag, ColumnMap({"position_m": Column("data", table="/p")}))
    assert read["position_m"].tolist() == list(range(100))
    assert "metadata.yaml is missing" in " ".join(read.preparation.remarks)


@pytest.mark.parametrize(
    ("second", "complaint"),
    [
        (range(2000, 2100), "b.mcap begins 1.099 s before the end of a.mcap"),
        (range(20_000, 20_100), "b.mcap begins 16.9 s after a.mcap"),
    ],
)
def test_files_of_several_recordings_are_refused(tmp_path: Path, second: range, complaint: str):
    bag = together(tmp_path / "bag", a=part(tmp_path / "p0", range(3100)), b=part(tmp_path / "p1", second))
    with pytest.raises(BadInput) as error:
        read_bag(bag)
    assert f"metadata.yaml is missing, and {complaint}; expected the files of one recording, or one of them" in str(error.value)


def changed(bag: Path, **entries: Any) -> Path:
    """Change entries of a bag's metadata.yaml."""
    file = bag / "metadata.yaml"
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    content["rosbag2_bagfile_information"] |= entries
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    return bag


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("entries", [{"storage_identifier": ""}, {"version": 10}, {"custom_data": None, "ros_distro": ""}])
def test_metadata_of_other_versions_and_indexed_anew_are_read(tmp_path: Path, storage: str, entries: dict[str, Any]):
    """`ros2 bag reindex` has left storage_identifier empty."""
    bag = changed(part(tmp_path / "bag", range(10), storage).parent, **entries)
    assert read_bag(bag)["force_n"].tolist() == list(range(10))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_profiles_that_differ_between_metadata_and_file_do_not_matter(tmp_path: Path, storage: str):
    """As after a change of the profiles for `ros2 bag play`, or from tools that lose them."""
    bag = part(tmp_path / "bag", range(10), storage).parent
    file = bag / "metadata.yaml"
    times = {name: {"sec": 0, "nsec": 0} for name in ("deadline", "lifespan", "liveliness_lease_duration")}
    numbers = {"history": 1, "depth": 10, "reliability": 1, "durability": 2, "liveliness": 1}
    profile = {**numbers, **times, "avoid_ros_namespace_conventions": False}
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    [topic] = content["rosbag2_bagfile_information"]["topics_with_message_count"]
    topic["topic_metadata"]["offered_qos_profiles"] = [profile]
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert read_bag(bag)["force_n"].tolist() == list(range(10))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags_without_metadata(tmp_path: Path, storage: str, mode: CompressionMode):
    states = [loader_state(k, force=float(k)) for k in range(20)]
    bag = record(tmp_path / "bag", states, storage, compression=mode)
    (bag / "metadata.yaml").unlink()
    [file] = bag.iterdir()
    for path in (bag, file):
        assert read_bag(path)["force_n"].tolist() == list(range(20))


def test_a_compressed_file_expanded_by_hand_is_read(tmp_path: Path):
    states = [loader_state(k, force=float(k)) for k in range(20)]
    bag = record(tmp_path / "bag", states, "sqlite3", compression=CompressionMode.FILE)
    [file] = bag.glob("*.zstd")
    (bag / file.stem).write_bytes(zstd.decompress(file.read_bytes()))
    file.unlink()
    assert read_bag(bag)["force_n"].tolist() == list(range(20))


def test_a_file_that_the_metadata_do_not_list_is_named(tmp_path: Path):
    bag = part(tmp_path / "bag", range(10)).parent
    part(tmp_path / "more", range(10, 20)).rename(bag / "more.mcap")
    read = read_bag(bag)
    assert read["force_n"].tolist() == list(range(10))
    assert read.preparation.remarks == ("more.mcap is not listed in metadata.yaml and left out",)


@pytest.mark.parametrize("key", ["version", "topics_with_message_count"])
def test_metadata_that_end_early_are_refused(tmp_path: Path, key: str):
    bag = part(tmp_path / "bag", range(10)).parent
    file = bag / "metadata.yaml"
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    del content["rosbag2_bagfile_information"][key]
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(BadInput, match=f"metadata.yaml has no {key}; expected an undamaged bag"):
        read_bag(bag)
    with pytest.raises(BadInput, match="it lists 0 messages by topic, and 10 in all"):
        read_bag(changed(bag, version=9, topics_with_message_count=[]))
