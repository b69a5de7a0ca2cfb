"""CDR compared with rosbags, which converts one message at a time, and with bytes sent by Fast DDS."""

import numpy as np
import pytest
from recorded_runs import loader_state, message, serialized
from rosbags.interfaces import Nodetype

from ehls_ros.recording.cdr import CdrError, decode, encode, flatten
from ehls_ros.recording.typestore import typestore

FRICTION = "ehls_msgs/msg/FrictionEstimate"
LOADER = "ehls_msgs/msg/LoaderState"
SENDER = "/ehls/friction_estimator_node-12"
FRICTION_FIELDS = flatten(typestore().fielddefs, FRICTION)
LOADER_FIELDS = flatten(typestore().fielddefs, LOADER)


def friction_message(cycle: int, forces: list[float], frame: str = "loader", *, little_endian: bool = True) -> bytes:
    fields = message("", "FrictionEstimate", cycle, 3_000_000_007, 0, {}).fields
    fields["header"].frame_id = frame
    slipping = np.array([force > 0 for force in forces])
    content = typestore().types[FRICTION](
        **fields, gms_force=cycle + 0.5, viscous_force=-1.0, sender=SENDER, element_forces=np.array(forces), slipping=slipping
    )
    return bytes(typestore().serialize_cdr(content, FRICTION, little_endian=little_endian))


def test_messages_of_different_lengths_and_byte_orders_are_decoded_together():
    messages = [
        friction_message(0, [1.0, -2.0, 3.0]),
        friction_message(1, []),
        friction_message(2, [4.0], frame=""),
        friction_message(3, [5.0, 6.0, -7.0], little_endian=False),
        friction_message(4, [-8.0, 9.0, 1.0]),
    ]
    wanted = {"cycle", "header.stamp.sec", "header.stamp.nanosec", "gms_force", "element_forces", "slipping"}
    columns = decode(messages, FRICTION_FIELDS, wanted)
    assert set(columns) == wanted
    assert columns["cycle"].tolist() == [0, 1, 2, 3, 4]
    assert columns["cycle"].dtype == np.uint64
    assert columns["header.stamp.sec"].tolist() == [3] * 5
    assert columns["header.stamp.nanosec"].tolist() == [7] * 5
    assert columns["gms_force"].tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
    nan = np.nan
    forces = [[1, -2, 3], [nan, nan, nan], [4, nan, nan], [5, 6, -7], [-8, 9, 1]]
    np.testing.assert_array_equal(columns["element_forces"], forces)
    slipping = [[1, 0, 1], [nan, nan, nan], [1, nan, nan], [1, 1, 0], [0, 1, 1]]
    np.testing.assert_array_equal(columns["slipping"], slipping)


@pytest.mark.parametrize("elements", [0, 1, 3])
@pytest.mark.parametrize("frame", ["", "loader", "a frame of another length"])
def test_encoding_gives_the_bytes_of_rosbags(elements: int, frame: str):
    forces = np.random.default_rng(2).normal(size=(5, elements))
    expected = [friction_message(cycle, forces[cycle].tolist(), frame) for cycle in range(5)]
    values = {
        "header.stamp.sec": np.full(5, 3),
        "header.stamp.nanosec": np.full(5, 7),
        "header.frame_id": frame,
        "cycle": np.arange(5),
        "gms_force": np.arange(5) + 0.5,
        "viscous_force": np.full(5, -1.0),
        "sender": SENDER,
        "element_forces": forces,
        "slipping": forces > 0,
    }
    assert encode(FRICTION_FIELDS, values) == expected


@pytest.mark.parametrize(
    ("wire", "elements", "slipping"),
    [
        (
            (
                "000100000300000007000000070000006c6f61646572000d880d880d0900000000000000000000000000f03f"
                "00000000000000000b0000002f65686c732f662d3132000003000000006a0100000000000000f03f0000000000000040"
                "000000000000084003000000010001"
            ),
            [1.0, 2.0, 3.0],
            [1, 0, 1],
        ),
        (  # padding has arbitrary content
            (
                "000100000300000007000000070000006c6f616465720025f00015050900000000000000000000000000f03f"
                "000000000000000002000000660034a0000000000000000005060518"
            ),
            [],
            [],
        ),
        (
            (
                "00010000000000000000000004000000616263000900000000000000000000000000f03f0000000000000000"
                "010000000000000000000000010000000100000000"
            ),
            [],
            [1],
        ),
    ],
)
def test_messages_serialized_by_fast_dds(wire: str, elements: list[float], slipping: list[int]):
    columns = decode([bytes.fromhex(wire)], FRICTION_FIELDS, {"cycle", "gms_force", "element_forces", "slipping"})
    assert columns["cycle"].tolist() == [9]
    assert columns["gms_force"].tolist() == [1.0]
    assert columns["element_forces"].tolist() == [elements]
    assert columns["slipping"].tolist() == [slipping]


def test_a_truncated_or_too_long_message_is_refused():
    whole = serialized(loader_state(1))
    assert decode([whole, whole + bytes(7)], LOADER_FIELDS, {"cycle"})["cycle"].tolist() == [1, 1]
    for wrong in [*(whole[:length] for length in range(len(whole))), whole + bytes(8)]:
        with pytest.raises(CdrError):
            decode([whole, wrong], LOADER_FIELDS, {"cycle"})


def test_other_encapsulations_are_refused():
    with pytest.raises(CdrError, match="00060000"):
        decode([bytes.fromhex("00060000") + bytes(60)], FRICTION_FIELDS, {"cycle"})


def test_no_messages_give_empty_columns():
    columns = decode([], FRICTION_FIELDS, {"cycle", "element_forces"})
    assert columns["cycle"].shape == (0,)
    assert columns["element_forces"].shape == (0, 0)


def test_what_follows_sequences_of_texts_and_messages_is_read():
    types, kind = typestore(), "sensor_msgs/msg/JointState"
    stamp = types.types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    messages = [
        types.types[kind](
            header=types.types["std_msgs/msg/Header"](stamp=stamp, frame_id="f"),
            name=names,
            position=np.array(positions),
            velocity=np.zeros(0),
            effort=np.array([7.0]),
        )
        for names, positions in [(["a", "bcd"], [1.0, 2.0]), ([], [3.0]), (["", "e" * 9, "f"], [4.0, 5.0, 6.0])]
    ]
    found = decode(
        [bytes(types.serialize_cdr(m, kind)) for m in messages], flatten(types.fielddefs, kind), {"position", "effort"}
    )
    np.testing.assert_array_equal(found["position"], [[1, 2, np.nan], [3, np.nan, np.nan], [4, 5, 6]])
    assert found["effort"].tolist() == [[7.0], [7.0], [7.0]]


def test_more_entries_than_a_message_holds_are_refused():
    nothing = [("none", (Nodetype.ARRAY, ((Nodetype.BASE, ("float64", 0)), 0)))]
    types = {
        "it/msg/Many": ([], [("many", (Nodetype.SEQUENCE, ((Nodetype.NAME, "it/msg/One"), 0)))]),
        "it/msg/One": ([], nothing),
    }
    many = bytes.fromhex("00010000ffffffff")
    with pytest.raises(CdrError, match="has 4294967295 entries"):
        decode([many], flatten(types, "it/msg/Many"), {})


def test_what_follows_an_array_of_messages_is_read():
    types = {
        "it/msg/Two": (
            [],
            [("two", (Nodetype.ARRAY, ((Nodetype.NAME, "it/msg/One"), 2))), ("last", (Nodetype.BASE, ("int16", 0)))],
        ),
        "it/msg/One": ([], [("text", (Nodetype.BASE, ("string", 0))), ("number", (Nodetype.BASE, ("uint8", 0)))]),
    }
    message = bytes.fromhex("00010000 02000000 6100 07 00 01000000 00 09 0300")
    assert decode([message], flatten(types, "it/msg/Two"), {"last"})["last"].tolist() == [3]


def test_a_wide_text_is_refused():
    types = {"it/msg/Wide": ([], [("text", (Nodetype.BASE, ("wstring", 0)))])}
    with pytest.raises(CdrError, match=r"field text of it/msg/Wide is of a kind that is not read"):
        flatten(types, "it/msg/Wide")
