"""Recorder of a graph: every message that a policy needs, read in bulk once the run is over."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from policies.trace import Report
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool

from ehls_msgs.msg import Refusal
from ehls_ros.nodes.codec import NANOSECONDS, decode_text
from ehls_ros.nodes.transport import RECORDER_DEPTH, Inbox, control_qos, message_class
from ehls_ros.recording.topics import (
    DIAGNOSTICS,
    DRIVER,
    DRIVING,
    LEAVING,
    REFUSED,
    STANDBY_COMMAND,
    TOPICS,
)

CYCLE_TOPICS = ("loader_state", "valve_command", "controller_status", "force_reference", "programme_point")
"""Topics with a message per cycle that policies evaluate."""

OCCASIONAL = 1000
"""Queue depth of the other topics."""


def _deserialised(kind: Any, fields: Callable[[Any], tuple[Any, ...]]) -> Callable[[bytes], tuple[Any, ...]]:
    return lambda message: fields(deserialize_message(message, kind))


class Ear:
    """Subscriptions without an executor: nothing is decoded before :meth:`listen`."""

    def __init__(self, node: Any, topics: Sequence[str] = CYCLE_TOPICS) -> None:
        """Subscribe; ``node`` is an rclpy node in the graph's namespace."""
        self._offset = time.time() - time.monotonic()
        self._heard: dict[str, list[tuple[Any, ...]]] = {}
        self.reports: list[Report] = []
        types = {topic.name: topic.type for topic in (*TOPICS, STANDBY_COMMAND, DRIVER)}
        known = {name: Inbox(node, message_class(types[name]), name, control_qos(RECORDER_DEPTH), owned="") for name in topics}
        kept = control_qos(OCCASIONAL)
        refusal = _deserialised(Refusal, lambda m: (m.header.stamp.sec, m.input, m.sender, m.owner))
        self._inboxes = known | {
            DRIVER.name: Inbox(node, message_class(DRIVER.type), DRIVER.name, kept, owned=""),
            STANDBY_COMMAND.name: Inbox(
                node, message_class(STANDBY_COMMAND.type), STANDBY_COMMAND.name, control_qos(RECORDER_DEPTH), owned=""
            ),
            DRIVING.name: Inbox(node, Bool, DRIVING.name, kept, _deserialised(Bool, lambda m: (m.data,))),
            LEAVING.name: Inbox(node, message_class(LEAVING.type), LEAVING.name, kept, lambda m: (decode_text(m),)),
            REFUSED.name: Inbox(node, Refusal, REFUSED.name, kept, refusal),
            DIAGNOSTICS.name: Inbox(node, DiagnosticArray, DIAGNOSTICS.name, QoSProfile(depth=OCCASIONAL), _status_of),
        }

    def listen(self) -> None:
        """Read the messages since the last call; more than a minute at 1 kHz would be lost."""
        for name, inbox in self._inboxes.items():
            heard = self._heard.setdefault(name, [])
            while (taken := inbox.take_raw()) is not None:
                when = taken[1]["source_timestamp"] / NANOSECONDS - self._offset
                # The inbox's decoder, with the time of sending added.
                decoded = inbox._decode(taken[0])
                if decoded is None:
                    continue
                if name == DIAGNOSTICS.name:
                    self.reports += [Report(when, *status) for status in decoded]
                else:
                    heard.append((when, *decoded))

    @property
    def messages(self) -> dict[str, list[tuple[Any, ...]]]:
        """Messages received, by topic: time of sending [s], stamp [ns] and fields."""
        return self._heard

    def close(self) -> None:
        """End the subscriptions."""
        for inbox in self._inboxes.values():
            inbox.destroy()


def _status_of(message: bytes) -> list[tuple[str, int, str, dict[str, str]]]:
    """Return node, level, message and values of each status in a message."""
    return [
        (status.name, int.from_bytes(status.level, "little"), status.message, {pair.key: pair.value for pair in status.values})
        for status in deserialize_message(message, DiagnosticArray).status
    ]
