"""Detection of publishers and readers with incompatible QoS policies, reported with the remedy.

The middleware does not match them, so no message passes, and reports only the last incompatible policy.
"""

from collections.abc import Iterator

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, ReliabilityPolicy, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""Name that the middleware gives a node whose name it has not discovered yet."""


class Mismatches:
    """QoS check of the topics of a node."""

    def __init__(self, node: Node) -> None:
        """Start with no endpoints seen."""
        self._node = node
        self._counts: dict[str, tuple[int, int]] = {}
        self.found: tuple[str, ...] = ()
        """One sentence for each endpoint that cannot be matched."""

    def look(self) -> None:
        """Check the graph; it is searched only when publishers or readers have come or gone."""
        node, name, namespace = self._node, self._node.get_name(), self._node.get_namespace()
        own = [
            *node.get_publisher_names_and_types_by_node(name, namespace),
            *node.get_subscriber_names_and_types_by_node(name, namespace),
        ]
        counts = {topic: (node.count_publishers(topic), node.count_subscribers(topic)) for topic, _ in own}
        if counts == self._counts:
            return
        found = tuple(sentence for topic in counts for sentence in self._on(topic))
        for sentence in found:
            if sentence not in self.found:
                node.get_logger().warning(sentence)
        self.found = found
        # The name of a node is discovered after its topics.
        self._counts = {} if any(UNKNOWN in sentence for sentence in found) else counts

    def _on(self, topic: str) -> Iterator[str]:
        publishers = self._node.get_publishers_info_by_topic(topic)
        readers = self._node.get_subscriptions_info_by_topic(topic)
        for publisher in publishers:
            reading = [reader for reader in readers if self._is_own(reader) and not self._is_own(publisher)]
            if reading and all(_incompatible(publisher, reader) for reader in reading):
                yield _sentence(topic, publisher, reading[0])
        for reader in readers:
            offering = [publisher for publisher in publishers if self._is_own(publisher) and not self._is_own(reader)]
            if offering and all(_incompatible(publisher, reader) for publisher in offering):
                yield _sentence(topic, offering[0], reader)

    def _is_own(self, endpoint: TopicEndpointInfo) -> bool:
        own = self._node.get_name(), self._node.get_namespace()
        return (endpoint.node_name, endpoint.node_namespace) == own


def _sentence(topic: str, publisher: TopicEndpointInfo, reader: TopicEndpointInfo) -> str:
    """Return the incompatibility of a publisher and a reader, and its remedy."""
    offered, wanted = publisher.qos_profile, reader.qos_profile
    unmet = [
        (policy, one.name.lower(), other.name.lower())
        for policy, one, other, lacking in (
            ("reliability", offered.reliability, wanted.reliability, ReliabilityPolicy.BEST_EFFORT),
            ("durability", offered.durability, wanted.durability, DurabilityPolicy.VOLATILE),
        )
        if one != other and one == lacking
    ]
    has = " and ".join(f"{policy} {one}" for policy, one, _ in unmet) or qos_check_compatible(offered, wanted)[1]
    asks = " and ".join(f"{policy} {other}" for policy, _, other in unmet) or "more"
    return (
        f"{topic}: {_name(publisher)} offers {has}, {_name(reader)} requests {asks}; publish what is requested, or request less"
    )


def _incompatible(publisher: TopicEndpointInfo, reader: TopicEndpointInfo) -> bool:
    compatibility, _ = qos_check_compatible(publisher.qos_profile, reader.qos_profile)
    return bool(compatibility == QoSCompatibility.ERROR)


def _name(endpoint: TopicEndpointInfo) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
