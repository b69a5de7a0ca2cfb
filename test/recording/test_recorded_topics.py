import pytest

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.recording.cdr import flatten
from ehls_ros.recording.topics import (
    CLOCK,
    CYCLE_TOPICS,
    DIAGNOSTICS,
    DRIVER,
    LOADER_STATE,
    MODEL_HEALTH,
    REFERENCE_TOPICS,
    REFUSED,
    RESPONSE,
    SENDER,
    TELEMETRY_TOPICS,
    TOPICS,
    Topic,
    known_topic,
    transition_topic,
)
from ehls_ros.recording.typestore import MESSAGE_FILES, typestore
from ehls_ros.trajectory import SIGNALS


def test_every_signal_comes_from_one_field():
    signals = [signal for topic in CYCLE_TOPICS for signal in topic.signals.values()]
    assert sorted([*signals, RESPONSE]) == sorted(SIGNALS)


@pytest.mark.parametrize("topic", CYCLE_TOPICS, ids=lambda topic: topic.name)
def test_the_fields_of_a_cycle_topic_are_header_cycle_and_its_signals(topic: Topic):
    fields = [field.name for field in flatten(typestore().fielddefs, topic.type)]
    assert fields[:4] == ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "cycle"]
    assert SENDER in fields
    assert [name for name in fields[4:] if name != SENDER] == [*topic.signals]


def test_every_quantity_a_controller_follows_has_a_topic():
    assert set(REFERENCE_TOPICS) == {CONTROLLERS.load(name).FOLLOWS for name in CONTROLLERS.names()}
    assert all(topic in CYCLE_TOPICS for topic in REFERENCE_TOPICS.values())


def test_every_message_definition_is_recorded_or_told_beside_the_recording():
    parts = {"ehls_msgs/msg/ModelChange", "ehls_msgs/msg/TrackedCoefficient"}
    assert {topic.type for topic in (*CYCLE_TOPICS, DRIVER, MODEL_HEALTH, REFUSED)} | parts == {
        f"ehls_msgs/msg/{file.stem}" for file in MESSAGE_FILES.iterdir()
    }


@pytest.mark.parametrize("topic", TELEMETRY_TOPICS, ids=lambda topic: topic.name)
def test_the_types_of_telemetry_are_known_and_carry_no_signal(topic: Topic):
    assert topic.type in typestore().fielddefs
    assert not topic.signals


def test_names_resolve_as_in_ros():
    assert LOADER_STATE.resolve() == "/ehls/loader_state"
    assert LOADER_STATE.resolve("/rig1/ehls") == "/rig1/ehls/loader_state"
    assert DIAGNOSTICS.resolve("/rig1/ehls") == "/diagnostics"


@pytest.mark.parametrize("topic", [*TOPICS, CLOCK, transition_topic("sic_node")], ids=lambda topic: topic.name)
def test_what_is_recorded_is_known_again(topic: Topic):
    path = topic.resolve("/rig1/ehls")
    found = known_topic(path, "/rig1/ehls")
    assert found is not None
    assert found._replace(name="") == topic._replace(name="")
    assert found.resolve("/rig1/ehls") == path


@pytest.mark.parametrize("path", ["/rig2/clock", "/rig2/sic_node/transition_event", "/transition_event", "/loader_state"])
def test_what_belongs_to_another_rig_is_not(path: str):
    assert known_topic(path, "/rig1/ehls") is None
