"""The monitor's report on the rig, as the dashboard shows it."""

import contextlib
import threading
from collections import deque
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from ehls_msgs.msg import ModelHealth
from ehls_ros.dashboard.graph import MAX_NAME, RigChange, RigCoefficient, RigHealth, shortened
from ehls_ros.nodes.transport import Inbox, control_qos
from ehls_ros.recording.topics import MODEL_HEALTH

MAX_POINTS = 360
"""Maximum number of values in a coefficient's trend."""

MAX_CHANGES, MAX_COEFFICIENTS = 20, 40
"""Maximum numbers of changes and coefficients shown."""

MAX_REPORT_SIZE = 64 * 1024
"""Size of the largest message read [B]; one with fifteen coefficients and a change has about 3 kB."""

STATES = {
    ModelHealth.LEARNING: "learning",
    ModelHealth.WATCHING: "watching",
    ModelHealth.EXAMINING: "examining",
    ModelHealth.IDLE: "idle",
}
"""Monitor states by name."""


class RigWatch:
    """Subscriber to a monitor that keeps the coefficients' recent values."""

    def __init__(self, node: Any) -> None:
        """Subscribe to the monitor.

        Args:
            node: the dashboard's node.
        """
        self._inbox = Inbox(node, ModelHealth, MODEL_HEALTH.name, control_qos(MODEL_HEALTH.depth), bytes)
        self._lock = threading.Lock()
        self._newest: ModelHealth | None = None
        self._past: dict[str, deque[tuple[float, float]]] = {}

    def take(self) -> None:
        """Read the messages that have arrived."""
        while (taken := self._inbox.take_raw()) is not None:
            if len(taken[0]) > MAX_REPORT_SIZE:
                continue
            # Another publisher's message may hold invalid UTF-8.
            with contextlib.suppress(UnicodeDecodeError):
                self._register(deserialize_message(taken[0], ModelHealth))

    def health(self) -> RigHealth | None:
        """Return the monitor's last report; None if there is no monitor, or none any more."""
        with self._lock:
            message = self._newest
            past = {name: tuple(points) for name, points in self._past.items()}
        if message is None or not self._inbox.handle.get_publisher_count():
            return None
        changes = [
            RigChange(shortened(c.sentence), bool(c.active), bool(c.acknowledged)) for c in message.changes[-MAX_CHANGES:]
        ]
        return RigHealth(
            state=STATES.get(message.state, ""),
            summary=shortened(message.summary),
            changes=tuple(reversed(changes)),
            coefficients=tuple(_coefficient(c, past) for c in message.coefficients[:MAX_COEFFICIENTS]),
            outside=float(np.clip(np.nan_to_num(message.outside), 0.0, 1.0)),
        )

    def destroy(self) -> None:
        """Unsubscribe."""
        self._inbox.destroy()

    def _register(self, message: ModelHealth) -> None:
        time = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        with self._lock:
            self._newest = message
            for coefficient in message.coefficients[:MAX_COEFFICIENTS]:
                name = shortened(coefficient.name, MAX_NAME)
                if name not in self._past and len(self._past) == MAX_COEFFICIENTS:
                    continue
                points = self._past.setdefault(name, deque(maxlen=MAX_POINTS))
                if points and time < points[-1][0]:
                    points.clear()  # the clock of another run
                if not points or time > points[-1][0]:
                    points.append((time, coefficient.value if coefficient.told else float("nan")))


def _coefficient(message: Any, past: dict[str, tuple[tuple[float, float], ...]]) -> RigCoefficient:
    name = shortened(message.name, MAX_NAME)
    times, values = zip(*past.get(name, ()), strict=True) if past.get(name) else ((), ())
    why_not = "" if message.told else shortened(message.why_not) or "not identified"
    return RigCoefficient(
        name, float(message.value), float(message.deviation), shortened(message.unit, MAX_NAME), why_not, times, values
    )
