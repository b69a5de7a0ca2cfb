"""Replacement for `ros2 bag play` where rosbag2 is not installed."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from ehls_ros.nodes.transport import message_class

DEFAULT_PROFILE = QoSProfile(depth=10)
"""ROS's default: reliable, volatile."""


def stored_profile(connection: Connection) -> QoSProfile:
    """Return the profile stored with a topic, with the default's depth, like rosbag2."""
    (stored,) = connection.ext.offered_qos_profiles
    return QoSProfile(
        depth=DEFAULT_PROFILE.depth,
        reliability=ReliabilityPolicy[stored.reliability.name],
        durability=DurabilityPolicy[stored.durability.name],
    )


class Replay:
    """A bag's messages, published again."""

    def __init__(self, node: Any, bag: Path, topics: Sequence[str], profile: Callable[[Connection], QoSProfile]) -> None:
        wanted = {f"{node.get_namespace()}/{topic}" for topic in topics}
        with Reader(bag) as reader:
            connections = [connection for connection in reader.connections if connection.topic in wanted]
            self._messages = [(connection.topic, stamp, data) for connection, stamp, data in reader.messages(connections)]
        self._publishers = {
            connection.topic: node.create_publisher(message_class(connection.msgtype), connection.topic, profile(connection))
            for connection in connections
        }

    def readers(self) -> int:
        """Return the number of matched readers of all topics."""
        return sum(publisher.get_subscription_count() for publisher in self._publishers.values())

    def play(self, rest: Callable[[float], None]) -> Iterator[tuple[str, int]]:
        """Publish the messages at the recorded pace, or at a slower pace set by the caller.

        Args:
            rest: waits for a time [s].

        Yields:
            The topic of each message, and how many have been published on it.
        """
        before, published = self._messages[0][1], Counter[str]()
        for topic, stamp, data in self._messages:
            rest(1e-9 * (stamp - before))
            before = stamp
            self._publishers[topic].publish(data)
            published[topic] += 1
            yield topic, published[topic]
