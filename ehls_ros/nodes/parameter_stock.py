"""Collector of the parameters of running nodes, for a recorder that joins after they were declared."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from rcl_interfaces.msg import Parameter, ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.serialization import serialize_message

from ehls_ros.recording.topics import PARAMETER_EVENTS
from ehls_ros.recording.typestore import typestore

PATIENCE = 5.0
"""Time without an answer after which a node is asked again [s]."""


class _Asked(NamedTuple):
    """Service clients of one node and the time of the last request."""

    names: Any
    values: Any
    at: float


class ParameterStock:
    """Requests all parameters of each node of the namespace once.

    Nodes publish their parameters on ``/parameter_events`` only when they are declared or change. The answers here are
    converted to the same form: an event in which all parameters are new.
    """

    def __init__(self, node: Node, tell: Callable[[int, bytes], None]) -> None:
        """Start with no node known.

        Args:
            node: the asking node; its executor serves the answers.
            tell: called with the time of an answer [ns] and the serialized ParameterEvent.
        """
        self._node = node
        self._tell = tell
        self._asked: dict[str, _Asked] = {}
        self._answered: set[str] = set()

    @property
    def known(self) -> int:
        """Number of nodes present that have answered."""
        return len(self._answered)

    def look(self) -> None:
        """Query new nodes, and repeat requests that are overdue."""
        own = self._node.get_namespace()
        present = {name for name, namespace in self._node.get_node_names_and_namespaces() if namespace == own}
        self._answered &= present
        for name in [name for name in self._asked if name in self._answered or name not in present]:
            self._forget(name)
        for name in present - self._answered:
            self._ask(name)

    def close(self) -> None:
        """Forget all nodes."""
        for name in list(self._asked):
            self._forget(name)

    def _ask(self, name: str) -> None:
        now = time.monotonic()
        asked = self._asked.get(name)
        if asked is None:
            names = self._node.create_client(ListParameters, f"{name}/list_parameters")
            values = self._node.create_client(GetParameters, f"{name}/get_parameters")
            asked = _Asked(names, values, -PATIENCE)
        if asked.names.service_is_ready() and asked.values.service_is_ready() and now - asked.at > PATIENCE:
            asked = asked._replace(at=now)
            asked.names.call_async(ListParameters.Request()).add_done_callback(partial(self._listed, name, asked.values))
        self._asked[name] = asked

    def _listed(self, name: str, client: Any, answer: Any) -> None:
        names = list(answer.result().result.names)
        client.call_async(GetParameters.Request(names=names)).add_done_callback(partial(self._got, name, names))

    def _got(self, name: str, names: list[str], answer: Any) -> None:
        if name in self._answered:
            return
        self._answered.add(name)
        event = ParameterEvent(node=f"{self._node.get_namespace()}/{name}")
        event.stamp = self._node.get_clock().now().to_msg()
        event.new_parameters = [
            Parameter(name=parameter, value=value) for parameter, value in zip(names, answer.result().values, strict=False)
        ]
        self._tell(time.time_ns(), _trimmed(serialize_message(event)))

    def _forget(self, name: str) -> None:
        asked = self._asked.pop(name)
        self._node.destroy_client(asked.names)
        self._node.destroy_client(asked.values)


def _trimmed(message: bytes) -> bytes:
    """Return a serialized ParameterEvent without the unused bytes that rmw leaves at its end."""
    event = typestore().get_msgdef(PARAMETER_EVENTS.type)
    _, size = event.deserialize_cdr_le(message[4:], 0, event.cls, typestore())
    return message[: 4 + size]
