"""The plant node's standard messages: the right quantity in the right unit, and only for measured signals."""

from types import SimpleNamespace

import pytest

pytest.importorskip("ehls_msgs", reason="needs ehls_msgs built, as `make setup` does")

from rclpy.serialization import deserialize_message

from ehls_ros.nodes.frames import JOINT, loader_frame
from ehls_ros.nodes.telemetry import Telemetry
from ehls_ros.physics.rig import EVERY_SENSED, SENSED
from ehls_ros.recording.topics import TELEMETRY_TOPICS

READ = {
    "position": 0.02,
    "velocity": -0.3,
    "load_pressure": -1.5e6,
    "spool_position": 1e-4,
    "force": -3900.0,
    "supply_pressure": 7e6,
    "oil_temperature": 313.15,
}


class StandIn:
    """A node that records its publications."""

    def __init__(self, namespace="/ehls"):
        self.namespace = namespace
        self.published = {}
        self.types = {}

    def get_namespace(self):
        return self.namespace

    def create_publisher(self, kind, topic, depth):
        sent = self.published.setdefault(topic, [])
        self.types[topic] = kind
        handle = SimpleNamespace(publish_raw=lambda message: sent.append(deserialize_message(message, kind)))
        return SimpleNamespace(get_subscription_count=lambda: 1, handle=handle)


def told(measured=SENSED, failing=(), namespace="/ehls"):
    """Return the one message of each topic that has a publisher; None where nothing was sent."""
    node = StandIn(namespace)
    readings = [float("nan") if name in {*failing, *(set(SENSED) - set(measured))} else READ[name] for name in SENSED]
    Telemetry(node, 50.0, measured).publish(0.0, 12_000_000_034, readings)
    return {topic: next(iter(sent), None) for topic, sent in node.published.items()}, node.types


def test_everything_measured_is_told_in_the_messages_units():
    said, types = told()
    assert said["force"].data == READ["force"]
    force = said["wrench"].wrench.force
    assert (force.x, force.y, force.z) == (READ["force"], 0.0, 0.0)
    assert said["load_pressure"].fluid_pressure == READ["load_pressure"]
    assert said["supply_pressure"].fluid_pressure == READ["supply_pressure"]
    assert said["oil_temperature"].temperature == pytest.approx(40.0)
    joints = said["joint_states"]
    assert joints.name == [JOINT]
    assert (list(joints.position), list(joints.velocity), list(joints.effort)) == ([0.02], [-0.3], [-3900.0])
    for topic, message in said.items():
        if topic != "force":
            assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 34)
            assert message.header.frame_id == "loader"
    listed = {topic.name: topic.type.rpartition("/")[2] for topic in TELEMETRY_TOPICS}
    assert {topic: kind.__name__ for topic, kind in types.items()}.items() <= listed.items()


def test_a_rig_with_two_chambers_tells_both_pressures():
    node = StandIn()
    pressures = {"pressure_a": 3e6, "pressure_b": 1e6}
    Telemetry(node, 50.0, EVERY_SENSED).publish(0.0, 0, [{**READ, **pressures}[name] for name in EVERY_SENSED])
    assert {name: node.published[name][0].fluid_pressure for name in pressures} == pressures


def test_what_a_rig_does_not_measure_has_no_topic_and_an_empty_array():
    said, _ = told(measured=("position", "load_pressure"))
    assert said.keys() == {"load_pressure", "joint_states"}
    joints = said["joint_states"]
    assert (list(joints.position), list(joints.velocity), list(joints.effort)) == ([0.02], [], [])


def test_a_reading_that_fails_is_left_out():
    said, _ = told(failing=("force", "position"))
    assert said["force"] is said["wrench"] is None
    assert (list(said["joint_states"].position), list(said["joint_states"].effort)) == ([], [])


def test_a_second_rig_tells_in_its_own_frame():
    said, _ = told(namespace="/rig2")
    assert said["wrench"].header.frame_id == loader_frame("/rig2") == "rig2/loader"
