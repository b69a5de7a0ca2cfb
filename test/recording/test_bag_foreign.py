"""Bags of other recorders: some of the topics, other namespaces, other versions, failed runs."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from recorded_runs import Message, definition_of, loader_state, message, record, storage_file, valve_command
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import BagWriter
from ehls_ros.recording.topics import LOADER_STATE
from ehls_ros.recording.typestore import typestore_of

NAN = np.nan


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("alone", [False, True])
def test_some_topics_in_another_namespace_at_another_rate(tmp_path: Path, storage: str, alone: bool):
    cycles = range(100, 150)
    states = [
        loader_state(k, "/rig1/ehls/loader_state", stamp_ns=k * 4 * 10**6, force=2.0 * k, position=-0.5 * k) for k in cycles
    ]
    references = [message("/rig1/ehls/force_reference", "ForceReference", k, 0, k, {"force": k + 0.25}) for k in cycles]
    others = [Message("/tf_static", "std_msgs/msg/Float64", 0, {"data": 1.0})]
    bag = record(tmp_path / "theirs", [*states, *references, *others], storage)
    trajectory = read_bag(storage_file(bag) if alone else bag)
    assert trajectory.time_s.tolist() == [k * 4 / 1000 for k in cycles]
    assert trajectory["force_n"].tolist() == [2.0 * k for k in cycles]
    assert trajectory["position_m"].tolist() == [-0.5 * k for k in cycles]
    assert trajectory["force_reference_n"].tolist() == [k + 0.25 for k in cycles]
    assert not {"valve_command_m", "response_s", "friction_gms_n", "e3_pa"} & set(trajectory.signals)
    assert trajectory.metadata == {}


def test_the_namespace_may_be_empty(tmp_path: Path):
    bag = record(
        tmp_path / "theirs", [loader_state(0, "/loader_state", force=3.0), valve_command(0, "/valve_command", spool=1.0)]
    )
    assert read_bag(bag)["valve_command_m"].tolist() == [1.0]


def test_signals_without_values_are_absent(tmp_path: Path):
    bag = record(tmp_path / "theirs", [loader_state(k, oil_temperature=NAN, velocity=NAN if k else 1.0) for k in range(3)])
    trajectory = read_bag(bag)
    assert "oil_temperature_k" not in trajectory
    np.testing.assert_array_equal(trajectory["velocity_m_s"], [1.0, NAN, NAN])


def test_the_response_is_the_time_between_two_arrivals(tmp_path: Path):
    delays_ns = {0: 150_000, 1: 90_000, 3: 1_200_000}
    states = [loader_state(k) for k in range(4)]
    commands = [valve_command(k, delay_ns=delay_ns) for k, delay_ns in delays_ns.items()]
    trajectory = read_bag(record(tmp_path / "theirs", [*states, *commands]))
    np.testing.assert_array_equal(trajectory["response_s"], [150e-6, 90e-6, NAN, 1200e-6])


def test_the_times_of_a_wall_clock_count_from_the_first_snapshot(tmp_path: Path):
    start_ns = 1_763_000_000_123_456_789
    bag = record(tmp_path / "theirs", [loader_state(k, stamp_ns=start_ns + k * 1_000_001) for k in range(4)])
    assert read_bag(bag).time_s.tolist() == [0.0, 0.001000001, 0.002000002, 0.003000003]


def test_messages_are_matched_by_cycle_in_any_order_of_arrival(tmp_path: Path):
    cycles = np.random.default_rng(3).permutation(40)
    states = [loader_state(int(k), force=float(k)) for k in cycles]
    commands = [valve_command(int(k), spool=100.0 + k) for k in cycles[::-1]]
    trajectory = read_bag(record(tmp_path / "theirs", [*commands, *states]))
    assert trajectory["force_n"].tolist() == list(range(40))
    assert trajectory["valve_command_m"].tolist() == [100.0 + k for k in range(40)]


def test_cycles_without_a_snapshot_give_no_samples(tmp_path: Path):
    states = [loader_state(k, force=float(k)) for k in (2, 3, 7)]
    commands = [valve_command(k, spool=float(k)) for k in (0, 1, 2, 3, 4, 7, 8)]
    trajectory = read_bag(record(tmp_path / "theirs", [*states, *commands]))
    assert trajectory.time_s.tolist() == [0.002, 0.003, 0.007]
    assert trajectory["valve_command_m"].tolist() == [2.0, 3.0, 7.0]


def test_the_first_answer_to_a_cycle_counts(tmp_path: Path):
    commands = [
        valve_command(0, delay_ns=100, spool=1.0),
        valve_command(0, delay_ns=900, spool=2.0),
        valve_command(1, delay_ns=900, spool=4.0),
        valve_command(1, delay_ns=100, spool=3.0),
    ]
    trajectory = read_bag(record(tmp_path / "theirs", [loader_state(0), loader_state(1), *commands]))
    assert trajectory["valve_command_m"].tolist() == [1.0, 3.0]
    assert trajectory["response_s"].tolist() == [1e-7, 1e-7]


def test_a_snapshot_delivered_twice_counts_once(tmp_path: Path):
    states = [loader_state(k, force=float(k), velocity=NAN) for k in (0, 1, 1, 2)]
    assert read_bag(record(tmp_path / "theirs", states))["force_n"].tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("messages", "complaint"),
    [
        (
            [loader_state(0), loader_state(1, force=1.0), loader_state(1, force=2.0)],
            "cycle 1 has two snapshots that differ; expected the snapshots of one run",
        ),
        (
            [loader_state(0), loader_state(1), loader_state(1, stamp_ns=5 * 10**6)],
            "cycle 1 has two snapshots that differ",
        ),
        (
            [loader_state(50), loader_state(51), loader_state(0, stamp_ns=9 * 10**7)],
            "time does not increase from cycle 0 to cycle 50: header.stamp is 0.09 s and 0.05 s; expected the snapshots of one",
        ),
        (
            [loader_state(0, stamp_ns=0), message("/ehls/loader_state", "LoaderState", 1, 1_764_000_000 * 10**9, 10**6, {})],
            "time jumps from cycle 0 to cycle 1: header.stamp is 0 s and 2025-11-24 16:00:00.000",
        ),
        (
            [loader_state(0, "/rig1/ehls/loader_state"), loader_state(0, "/rig2/ehls/loader_state")],
            "it contains several rigs: /rig1/ehls, /rig2/ehls; expected one rig per bag",
        ),
        (
            [valve_command(0), valve_command(0, "/b/valve_command")],
            (
                "topic loader_state is missing (found: /b/valve_command, /ehls/valve_command); "
                "expected a topic of ehls_msgs/msg/LoaderState"
            ),
        ),
        (
            [Message("/ehls/loader_state", "std_msgs/msg/Float64", 0, {"data": 1.0})],
            "/ehls/loader_state: its messages are std_msgs/msg/Float64; expected ehls_msgs/msg/LoaderState",
        ),
        (
            [loader_state(0), Message("/ehls/force_reference", "std_msgs/msg/Float64", 0, {"data": 1.0})],
            "/ehls/force_reference: its messages are std_msgs/msg/Float64; expected ehls_msgs/msg/ForceReference",
        ),
    ],
)
def test_bags_that_are_not_one_run_are_bad_input(tmp_path: Path, messages: list[Message], complaint: str):
    with pytest.raises(BadInput) as caught:
        read_bag(record(tmp_path / "theirs", messages))
    assert complaint in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "theirs"))


def test_a_bag_without_a_snapshot_is_bad_input(tmp_path: Path):
    BagWriter.create(tmp_path / "bag").close()
    with pytest.raises(BadInput, match="there is no message on loader_state"):
        read_bag(tmp_path / "bag")


def hash_of(definition: str) -> str:
    text = MessageDefinition(MessageDefinitionFormat.MSG, definition)
    return typestore_of(text, LOADER_STATE.type).hash_rihs01(LOADER_STATE.type)


def record_own_version(path: Path, definition: str) -> Path:
    """Record two snapshots of force 1 and 2 with another definition of LoaderState than that of ehls_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(definition, LOADER_STATE.type))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/ehls/loader_state", LOADER_STATE.type, msgdef=definition, rihs01=hash_of(definition))
        for cycle in (0, 1):
            fields: dict[str, Any] = dict.fromkeys([name for name, _ in store.fielddefs[LOADER_STATE.type][1]], 0)
            own = {"force": cycle + 1, "extra": np.zeros(2 * cycle, np.float32), "sender": "theirs"}
            fields |= loader_state(cycle).fields | own
            content = store.types[LOADER_STATE.type](**fields)
            writer.write(topic, cycle, store.serialize_cdr(content, LOADER_STATE.type))
    return path


@pytest.mark.parametrize("alone", [False, True], ids=["hash in metadata.yaml", "no hash"])
def test_messages_of_another_version_are_read_by_the_definition_in_the_bag(tmp_path: Path, alone: bool):
    theirs = definition_of(LOADER_STATE.type)
    theirs = theirs.replace("float64 oil_temperature ", "# ").replace(
        "float64 position ", "bool warm\nfloat32[] extra\nfloat64 position "
    )
    bag = record_own_version(tmp_path / "theirs", theirs)
    trajectory = read_bag(storage_file(bag) if alone else bag)
    assert trajectory["force_n"].tolist() == [1.0, 2.0]
    assert trajectory["position_m"].tolist() == [0.0, 0.0]
    assert "oil_temperature_k" not in trajectory


def test_a_status_from_before_it_named_its_sender_is_in_the_papers_units(tmp_path: Path):
    """e3 in MPa and u1 in t MPa/s^2, in a command and a status without a sender."""
    fields = {"e3": 0.5, "u1": 2.0, "force_error": 3.0}
    status = message("/ehls/controller_status", "ControllerStatus", 0, 0, 0, fields)
    run = [loader_state(0), valve_command(0, spool=1e-3), status]
    store = get_typestore(Stores.ROS2_JAZZY)
    definitions = {}
    for kind in {each.type for each in run}:
        text = re.sub(r"^string sender.*\n", "", definition_of(kind), flags=re.MULTILINE)
        store.register(get_types_from_msg(text, kind))
        definitions[kind] = text, store.hash_rihs01(kind)
    read = read_bag(record(tmp_path / "present", run))
    earlier = read_bag(record(tmp_path / "earlier", run, definitions=definitions, store=store))
    assert [read[name].tolist() for name in ("e3_pa", "u1_kg_pa_s2")] == [[0.5], [2.0]]
    assert [earlier[name].tolist() for name in ("e3_pa", "u1_kg_pa_s2")] == [[0.5e6], [2e9]]
    for name in ("valve_command_m", "force_error_n", "response_s"):
        assert earlier[name].tolist() == read[name].tolist()


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("float64 force ", "float32 force ", "has float32 force in this bag; expected float64 force"),
        ("float64 force ", "string force_unit\nint16 force ", "has int16 force in this bag; expected float64 force"),
        ("uint64 cycle ", "uint64 counter ", "has no field cycle in this bag; expected a header and a cycle"),
        ("float64 velocity ", "std_msgs/Header[] velocity ", "has string[] velocity in this bag"),
    ],
)
def test_a_version_with_other_types_is_bad_input(tmp_path: Path, old: str, new: str, complaint: str):
    theirs = definition_of(LOADER_STATE.type).replace(old, new)
    bag = record(tmp_path / "theirs", [loader_state(0)], definitions={LOADER_STATE.type: (theirs, hash_of(theirs))})
    with pytest.raises(BadInput) as caught:
        read_bag(bag)
    assert complaint in str(caught.value)


def test_a_definition_that_is_not_the_one_recorded_is_bad_input(tmp_path: Path):
    swapped = (
        definition_of(LOADER_STATE.type)
        .replace("float64 position ", "float64 x ")
        .replace("float64 velocity ", "float64 position ")
    )
    other = definition_of(LOADER_STATE.type).replace("float64 position ", "float64 x ")
    bag = record(tmp_path / "theirs", [loader_state(0)], definitions={LOADER_STATE.type: (swapped, hash_of(other))})
    with pytest.raises(BadInput, match="definition of ehls_msgs/msg/LoaderState is missing or wrong"):
        read_bag(bag)


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        ("mcap", CompressionMode.STORAGE),
        ("mcap", CompressionMode.MESSAGE),
        ("mcap", CompressionMode.FILE),
        ("sqlite3", CompressionMode.MESSAGE),
        ("sqlite3", CompressionMode.FILE),
    ],
)
def test_compressed_bags(tmp_path: Path, storage: str, compression: CompressionMode):
    states = [loader_state(k, force=float(k)) for k in range(50)]
    bag = record(tmp_path / "theirs", states, storage, compression=compression)
    assert read_bag(bag)["force_n"].tolist() == list(range(50))


def split_bag(tmp_path: Path) -> Path:
    """Return a bag of two storage files, as made by a recorder with a size limit."""
    first, second = (
        record(tmp_path / name, [loader_state(k, force=float(k)) for k in range(start, start + 30)])
        for name, start in (("first", 0), ("second", 30))
    )
    storage_file(second).rename(first / storage_file(second).name)
    metadata = first / "metadata.yaml"
    content = yaml.safe_load(metadata.read_text(encoding="utf-8"))
    information = content["rosbag2_bagfile_information"]
    information["relative_file_paths"] = ["first.mcap", "second.mcap"]
    information["message_count"] = information["topics_with_message_count"][0]["message_count"] = 60
    metadata.write_text(yaml.safe_dump(content), encoding="utf-8")
    return first


def test_a_bag_of_several_files_is_read_as_one(tmp_path: Path):
    assert read_bag(split_bag(tmp_path))["force_n"].tolist() == list(range(60))


def test_a_bag_that_lacks_one_of_its_files_is_bad_input(tmp_path: Path):
    bag = split_bag(tmp_path)
    (bag / "second.mcap").unlink()
    with pytest.raises(BadInput, match=r"the storage file second.mcap cannot be read \(No such file"):
        read_bag(bag)


def test_a_bag_with_fewer_messages_than_its_metadata_say_is_bad_input(tmp_path: Path):
    bag = split_bag(tmp_path)
    fewer = record(tmp_path / "fewer", [loader_state(k) for k in range(30, 55)])
    storage_file(fewer).replace(bag / "second.mcap")
    with pytest.raises(BadInput, match="/ehls/loader_state: 55 of 60 messages are there"):
        read_bag(bag)
