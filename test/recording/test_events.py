"""The events of a run are read from its bag."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import loader_state, make_trajectory, serialized

from ehls_ros.cli.main import main
from ehls_ros.errors import BadInput
from ehls_ros.recording.bag_writer import BagWriter, Storage, write_trajectory
from ehls_ros.recording.events import Event, Pause, read_events, read_pauses, time_closed
from ehls_ros.recording.recovery import recover
from ehls_ros.recording.topics import DIAGNOSTICS, DRIVING, PARAMETER_EVENTS, transition_topic
from ehls_ros.recording.typestore import typestore

START_NS = 1_700_000_000 * 10**9
LAW, PLANT = "fasmc_node", "plant_sim_node"
EMPTY: dict[str, Any] = {
    "bool_value": False,
    "integer_value": 0,
    "double_value": 0.0,
    "string_value": "",
    "byte_array_value": np.zeros(0, np.uint8),
    "bool_array_value": np.zeros(0, bool),
    "integer_array_value": np.zeros(0, np.int64),
    "double_array_value": np.zeros(0),
    "string_array_value": [],
}


def made(kind: str, **fields: Any) -> Any:
    return typestore().types[kind](**fields)


def stamp(stamp_ns: int = 0) -> Any:
    return made("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def parameter(name: str, kind: int, **value: Any) -> Any:
    content = made("rcl_interfaces/msg/ParameterValue", type=kind, **{**EMPTY, **value})
    return made("rcl_interfaces/msg/Parameter", name=name, value=content)


def parameters(node: str, *, new: Any = (), changed: Any = ()) -> bytes:
    lists = {"new_parameters": list(new), "changed_parameters": list(changed), "deleted_parameters": []}
    event = made(PARAMETER_EVENTS.type, stamp=stamp(), node=node, **lists)
    return bytes(typestore().serialize_cdr(event, PARAMETER_EVENTS.type))


def transition(start: tuple[int, str], goal: tuple[int, str]) -> bytes:
    states = [made("lifecycle_msgs/msg/State", id=number, label=label) for number, label in (start, goal)]
    kind = transition_topic("").type
    moved = made("lifecycle_msgs/msg/Transition", id=0, label="")
    event = made(kind, timestamp=0, transition=moved, start_state=states[0], goal_state=states[1])
    return bytes(typestore().serialize_cdr(event, kind))


def diagnostics(node: str, level: int, message: str, *, of_gate: bool) -> bytes:
    values = [made("diagnostic_msgs/msg/KeyValue", key="owner", value="nobody")] if of_gate else []
    status = made(
        "diagnostic_msgs/msg/DiagnosticStatus", level=level, name=node, message=message, hardware_id="ehls", values=values
    )
    header = made("std_msgs/msg/Header", stamp=stamp(), frame_id="")
    return bytes(typestore().serialize_cdr(made(DIAGNOSTICS.type, header=header, status=[status]), DIAGNOSTICS.type))


def record(path: Path, told: Callable[[Callable[[str, float, bytes], None]], None], storage: Storage = "mcap") -> Path:
    """Record ten snapshots, 1 ms apart, each sent 2 ms after its sample, and the messages of ``told`` at relative times."""
    with BagWriter.create(path, storage) as writer:
        for cycle in range(10):
            message = serialized(loader_state(cycle, stamp_ns=START_NS + cycle * 10**6))
            writer.write("loader_state", START_NS + cycle * 10**6 + 2 * 10**6, message)

        def write(topic: str, after_s: float, message: bytes) -> None:
            writer.write(topic, START_NS + round(after_s * 1e9), message)

        writer.add_topic(transition_topic(LAW))
        told(write)
    return path


def a_tuned_run(write: Callable[[str, float, bytes], None]) -> None:
    events, law = PARAMETER_EVENTS.name, f"/ehls/{LAW}"
    write(transition_topic(LAW).name, 0.0, transition((13, "activating"), (3, "active")))
    write(events, 0.0021, parameters(law, new=[parameter("k", 3, double_value=12.0), parameter("law", 4, string_value="a")]))
    write(events, 0.0052, parameters(law, changed=[parameter("k", 3, double_value=15.0)]))
    # Set again, and never published before.
    write(events, 0.0062, parameters(law, changed=[parameter("k", 3, double_value=15.0), parameter("g", 2, integer_value=7)]))
    write(transition_topic(LAW).name, 1.0, transition((3, "active"), (14, "deactivating")))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_parameter_set_while_it_ran_is_found_with_time_and_values(tmp_path: Path, storage: Storage):
    found = [
        Event(None, LAW, "activating → active"),
        Event(0.003, LAW, "k: 12.0 → 15.0"),
        Event(0.004, LAW, "g: not known → 7"),
    ]
    bag = record(tmp_path / "bag", a_tuned_run, storage)
    assert read_events(bag) == found
    recovery = recover(bag, tmp_path / "whole")
    assert (recovery.lost, recovery.unverified, recovery.remarks) == (0, 0, [])
    assert read_events(tmp_path / "whole") == found


def test_it_stands_in_the_report(tmp_path: Path):
    bag = record(tmp_path / "bag", a_tuned_run)
    assert main(["report", str(bag), "--out", str(tmp_path / "report.html")]) == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in ("Events", "k: 12.0 → 15.0", "0.003", LAW):
        assert words in page


def test_trips_are_told_once_and_troubles_of_other_nodes_when_they_come_up(tmp_path: Path):
    def told(write: Callable[[str, float, bytes], None]) -> None:
        for after_s, node, level, message in (
            (0.001, PLANT, 0, "active"),
            (0.0025, PLANT, 2, "cut, tripped by force 12.1 kN"),
            (0.0035, PLANT, 2, "cut, tripped by force 12.2 kN"),
            (0.004, LAW, 0, "running"),
            (0.0045, LAW, 1, "no friction estimate arrives"),
            (0.005, LAW, 1, "no friction estimate arrives"),
            (0.006, PLANT, 0, "disabled"),
            (0.007, LAW, 0, "running"),
            (0.008, LAW, 1, "no friction estimate arrives"),
        ):
            write(DIAGNOSTICS.name, after_s, diagnostics(node, level, message, of_gate=node == PLANT))

    events = [(event.node, event.what) for event in read_events(record(tmp_path / "bag", told))]
    assert events == [
        (PLANT, "active"),
        (PLANT, "cut, tripped by force 12.1 kN"),
        (LAW, "no friction estimate arrives"),
        (PLANT, "disabled"),
        (LAW, "no friction estimate arrives"),
    ]


def test_a_bag_written_from_a_trajectory_tells_of_nothing(tmp_path: Path):
    write_trajectory(tmp_path / "bag", make_trajectory())
    assert read_events(tmp_path / "bag") == []


@pytest.mark.parametrize("message", [b"\0\1\0\0", b"\0\1\0\0" + bytes(70_000), b""], ids=["truncated", "too long", "empty"])
def test_a_message_that_is_none_is_bad_input(tmp_path: Path, message: bytes):
    bag = record(tmp_path / "bag", lambda write: write(PARAMETER_EVENTS.name, 0.001, message))
    with pytest.raises(BadInput, match=PARAMETER_EVENTS.name):
        read_events(bag)


def test_times_without_a_driver_are_read_from_the_bag(tmp_path):
    def tell(write):
        # Snapshots are sent at 2, 3, … ms; three announcements are one pause.
        for after_s, driven in ((0.0001, True), (0.0041, False), (0.0052, False), (0.0071, True), (0.0095, False)):
            message = typestore().serialize_cdr(made(DRIVING.type, data=driven), DRIVING.type)
            write(DRIVING.name, after_s, bytes(message))

    assert read_pauses(record(tmp_path / "bag", tell)) == [Pause(0.002, 0.005), Pause(0.007, np.inf)]
    assert read_pauses(record(tmp_path / "none", lambda write: None)) == []


def test_only_pauses_within_a_run_count_as_closed():
    pauses = [Pause(-np.inf, 0.1), Pause(1.0, 1.5), Pause(2.0, 2.25), Pause(3.0, np.inf)]
    assert time_closed(pauses, 0.0, 4.0) == 0.75
    assert time_closed(pauses, 1.0, 2.1) == 0.0
