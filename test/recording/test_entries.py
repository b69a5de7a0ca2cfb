"""Entries of sequences by number and label, where the senders of one topic differ in order and number of entries."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import Message, record
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap
from ehls_ros.recording.load import load
from ehls_ros.recording.proposal import look
from ehls_ros.trajectory import Trajectory

STORE = get_typestore(Stores.ROS2_JAZZY)
DEFINITIONS = {
    # As of control_msgs and pal_statistics_msgs.
    "it_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "it_msgs/msg/DynamicJointState": "string[] joint_names\nit_msgs/InterfaceValue[] interface_values\n",
    "it_msgs/msg/Statistic": "string name\nfloat64 value\n",
    "it_msgs/msg/Statistics": "it_msgs/Statistic[] statistics\n",
    "it_msgs/msg/Point": "float64[] positions\n",
    "it_msgs/msg/ControllerState": "string[] joint_names\nit_msgs/Point feedback\nstring[] notes\n",
}
for kind, text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(text, kind))
TYPES = STORE.types


def bag_of(folder: Path, contents: list[Any]) -> Path:
    """Return a bag of one topic /t with a message every millisecond, received when it was sent."""
    messages = [Message("/t", c.__msgtype__, k * 10**6, {f: getattr(c, f) for f in c.__dataclass_fields__ if f[0] != "_"})
                for k, c in enumerate(contents)]  # fmt: skip
    kinds = {c.__msgtype__ for c in contents}
    definitions = {kind: (STORE.generate_msgdef(kind, ros_version=2)[0], STORE.hash_rihs01(kind)) for kind in kinds}
    return record(folder / "theirs", messages, definitions=definitions, store=STORE)


def joints(names: list[str], positions: list[float]) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    nothing = np.zeros(0)
    return TYPES["sensor_msgs/msg/JointState"](header, names, np.array(positions), nothing, nothing)


def read(bag: Path, **names: str) -> Trajectory:
    columns = {signal: Column(name, table="/t") for signal, name in names.items()}
    return load(bag, ColumnMap(columns, tables={"/t": Column("received")}))


TWO_SENDERS = [
    joints(["rod", "boom"], [1.0, 5.0]),
    joints(["boom", "hook", "rod"], [5.0, 7.0, 2.0]),
    joints(["rod", "boom"], [3.0, 5.0]),
]


def test_an_entry_whose_label_changes_is_refused_and_read_by_label(tmp_path: Path):
    bag = bag_of(tmp_path, TWO_SENDERS)
    with pytest.raises(BadInput) as error:
        read(bag, position_m="position[0]")
    assert (
        "/t: field 'position[0]' for position_m is 'rod' in message 1 and 'boom' in message 2; 1 of 3 messages differ from the "
        'first; expected one meaning: a label in the brackets, such as name: "position[rod]"'
    ) in str(error.value)
    both = read(bag, position_m="position[rod]", force_n="position[hook]")
    np.testing.assert_array_equal(both["position_m"], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(both["force_n"], [np.nan, 7.0, np.nan])
    assert both.preparation.remarks == ("position_m and force_n: 2 messages have no position[hook]: force_n is missing there",)


def test_messages_without_the_label_are_left_out_and_counted(tmp_path: Path):
    hook = read(bag_of(tmp_path, [*TWO_SENDERS, *TWO_SENDERS]), position_m="position[hook]")
    assert hook.time_s == pytest.approx([0.001, 0.004])
    assert hook.preparation.remarks == ("position_m: 4 of 6 messages have no position[hook] and are left out",)


@pytest.mark.parametrize(
    ("contents", "name", "complaint"),
    [
        (
            TWO_SENDERS,
            "position[2]",
            "missing in 2 of 3 messages, first in message 1, which has 2 entries; expected a label in the brackets",
        ),
        (
            TWO_SENDERS,
            "position[bucket]",
            "is missing: no message has this label; expected a label of its messages; `ehls columns",
        ),
        (TWO_SENDERS, "position[]", "field 'position[]' for position_m is missing (found: header.stamp.sec"),
        ([joints(["a", "a"], [1.0, 2.0])], "position[a]", "'position[a]' is ambiguous"),
        (
            [joints(["a"], [1.0]), joints([], [2.0])],
            "position[0]",
            "is 'a' in message 1 and without a label in message 2",
        ),
        ([joints([], [1.0]), joints([], [1.0, 2.0])], "position[1]", "1 entries; expected a number that all messages have"),
    ],
)
def test_an_entry_without_one_meaning_is_refused(tmp_path: Path, contents: list[Any], name: str, complaint: str):
    with pytest.raises(BadInput) as error:
        read(bag_of(tmp_path, contents), position_m=name)
    assert complaint in str(error.value)


def test_empty_messages_are_left_out(tmp_path: Path):
    contents = [joints([], []), joints(["a"], [1.0]), joints([], []), joints(["a"], [2.0])]
    found = read(bag_of(tmp_path, contents), position_m="position[0]")
    assert found["position_m"].tolist() == [1.0, 2.0]
    assert "2 of 4 messages have no position[0] and are left out" in found.preparation.remarks[0]


def test_a_label_that_is_a_number_stands_in_quotes(tmp_path: Path):
    bag = bag_of(tmp_path, [joints(["2", "1"], [1.0, 2.0]), joints(["1", "2"], [2.0, 1.0])])
    assert read(bag, position_m='position["1"]')["position_m"].tolist() == [2.0, 2.0]
    [table] = look(bag)
    assert [column.header.column for column in table.columns] == ['position["2"]', 'position["1"]']


def dynamic(values: dict[str, dict[str, float]]) -> Any:
    parts = [TYPES["it_msgs/msg/InterfaceValue"](list(part), np.array(list(part.values()))) for part in values.values()]
    return TYPES["it_msgs/msg/DynamicJointState"](list(values), parts)


def statistics(**values: float) -> Any:
    parts = [TYPES["it_msgs/msg/Statistic"](name, value) for name, value in values.items()]
    return TYPES["it_msgs/msg/Statistics"](parts)


def state(names: list[str], positions: list[float]) -> Any:
    return TYPES["it_msgs/msg/ControllerState"](names, TYPES["it_msgs/msg/Point"](np.array(positions)), [])


def poses(names: list[str], places: list[float]) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    turn = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    moved = [TYPES["geometry_msgs/msg/Transform"](TYPES["geometry_msgs/msg/Vector3"](x, 0.0, 0.0), turn) for x in places]
    return TYPES["sensor_msgs/msg/MultiDOFJointState"](header, names, moved, [], [])


def frames(names: list[str], places: list[float]) -> Any:
    content = poses(names, places)
    transform = TYPES["geometry_msgs/msg/TransformStamped"]
    return TYPES["tf2_msgs/msg/TFMessage"](
        [transform(content.header, name, moved) for name, moved in zip(names, content.transforms, strict=True)]
    )


@pytest.mark.parametrize(
    ("contents", "number", "label"),
    [
        (
            [
                dynamic({"rod": {"position": 1.0, "effort": 8.0}}),
                dynamic({"boom": {"position": 5.0}, "rod": {"effort": 9.0, "position": 2.0}}),
            ],
            "interface_values[0].values[0]",
            "interface_values[rod].values[position]",
        ),
        ([statistics(p=1.0, q=5.0), statistics(q=5.0, p=2.0)], "statistics[0].value", "statistics[p].value"),
        ([state(["a", "b"], [1.0, 5.0]), state(["b", "a"], [5.0, 2.0])], "feedback.positions[0]", "feedback.positions[a]"),
        (
            [poses(["a", "b"], [1.0, 5.0]), poses(["b", "a"], [5.0, 2.0])],
            "transforms[0].translation.x",
            "transforms[a].translation.x",
        ),
        (
            [frames(["a"], [1.0]), frames(["b", "a"], [5.0, 2.0])],
            "transforms[0].transform.translation.x",
            "transforms[a].transform.translation.x",
        ),
    ],
    ids=["texts at two levels", "text in each entry", "texts above the sequence", "texts beside messages", "frames"],
)
def test_labels_of_other_types(tmp_path: Path, contents: list[Any], number: str, label: str):
    bag = bag_of(tmp_path, contents)
    with pytest.raises(BadInput, match=r"is '.*' in message 1 and '.*' in message 2"):
        read(bag, position_m=number)
    assert read(bag, position_m=label)["position_m"].tolist() == [1.0, 2.0]
    [table] = look(bag)
    assert label in [column.header.column for column in table.columns]


def test_more_labels_than_a_topic_may_have_are_refused(tmp_path: Path):
    bag = bag_of(tmp_path, [joints([f"{k:03}"], [1.0]) for k in range(100)])
    with pytest.raises(BadInput, match="strings and sequences of more than 64 different lengths, or labels"):
        read(bag, position_m="position[0]")
