"""Diagnostics of a node: state on /diagnostics, once a second and on change; warnings and errors in the log."""

import math
import re
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ehls_ros.nodes.mismatches import Mismatches

if TYPE_CHECKING:
    from ehls_ros.nodes.control import ControlNode

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

REPEAT = 10.0
"""Minimum time between two log entries of one warning, irrespective of the numbers in it [s]."""

Health = tuple[bytes, str, Mapping[str, Any]]
"""Level, message and figures."""


def figures_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a node's diagnostics by name."""
    return {pair.key: pair.value for pair in status.values}


class Diagnostics:
    """Diagnostics of one node."""

    def __init__(self, node: "ControlNode") -> None:
        """Open the topic."""
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._mismatches = Mismatches(node)
        self._reported: tuple[bytes, str] | None = None
        self._warned: dict[str, float] = {}

    def check_topics(self) -> None:
        """Check the quality of service of the node's topics."""
        self._mismatches.look()

    def health(self) -> Health:
        """Return the state of the node, including its scheduling, its topics and the owners of its inputs."""
        node = self._node
        if node.refused:
            return ERROR, node.refused, {}
        if not node.lifecycle.configured:
            return OK, "unconfigured", {}
        level, message, figures = node.health()
        if level == OK and node.is_active and (missing := node.missing_time()):
            # In lockstep the source of the time, the plant, starts last.
            level, message = OK if node.lockstep else WARN, missing
        complaints = self._mismatches.found[:1]
        for complaint in (node.scheduling.complaint, *complaints, node.owners.complaint()):
            if complaint:
                level, message = max(level, WARN), f"{complaint}; {message}"
        lists = {"not_permitted": node.scheduling.not_permitted, "not_matched": self._mismatches.found}
        numbered = {f"{key}_{i}": text for key, texts in lists.items() for i, text in enumerate(texts, 1)}
        return level, message, {**figures, **node.scheduling.figures(), **numbered}

    def publish(self, level: bytes, message: str, figures: Mapping[str, Any]) -> None:
        """Publish a state; log it if it is a new warning or error."""
        node = self._node
        status = DiagnosticStatus(
            level=level,
            name=node.shown_name,
            message=message,
            hardware_id=node.get_namespace().strip("/"),
            values=[
                KeyValue(key=key, value=f"{value:.6g}" if isinstance(value, float) else str(value))
                for key, value in figures.items()
            ],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = node.get_clock().now().to_msg()
        self._publisher.publish(array)
        if (level, message) != self._reported and level != OK:
            self._log(level, f"{message}{node.advice()}")
        self._reported = (level, message)

    def _log(self, level: bytes, message: str) -> None:
        # rclpy binds each call site to the severity of its first call.
        if level == ERROR:
            self._node.get_logger().error(message)
            return
        kind, now = re.sub(r"[\d.]+", "", message), time.monotonic()
        if now - self._warned.get(kind, -math.inf) >= REPEAT:
            self._warned[kind] = now
            self._node.get_logger().warning(message)

    def report(self) -> None:
        """Publish the present state."""
        self.publish(*self.health())

    def report_change(self) -> None:
        """Publish the present state if level or message have changed."""
        level, message, figures = self.health()
        if (level, message) != self._reported:
            self.publish(level, message, figures)
