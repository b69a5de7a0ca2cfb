"""The loader's signals as standard messages at a low rate, for common ROS tools."""

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import FluidPressure, JointState, Temperature
from std_msgs.msg import Float64, Header

from ehls_ros.nodes.codec import NANOSECONDS, Template
from ehls_ros.nodes.frames import JOINT, loader_frame
from ehls_ros.nodes.transport import links_of, message_class
from ehls_ros.physics.rig import EVERY_SENSED
from ehls_ros.recording.topics import (
    FORCE,
    JOINT_STATES,
    LOAD_PRESSURE,
    OIL_TEMPERATURE,
    PRESSURE_A,
    PRESSURE_B,
    SUPPLY_PRESSURE,
    WRENCH,
    Topic,
)

ZERO_CELSIUS = 273.15
"""0 °C [K]."""

MESSAGES: tuple[tuple[Topic, str, float, Callable[[Header, float], Any]], ...] = (
    (FORCE, "force", 0.0, lambda header, value: Float64(data=value)),
    (WRENCH, "force", 0.0, lambda header, value: WrenchStamped(header=header, wrench=Wrench(force=Vector3(x=value)))),
    (LOAD_PRESSURE, "load_pressure", 0.0, lambda header, value: FluidPressure(header=header, fluid_pressure=value)),
    (SUPPLY_PRESSURE, "supply_pressure", 0.0, lambda header, value: FluidPressure(header=header, fluid_pressure=value)),
    (PRESSURE_A, "pressure_a", 0.0, lambda header, value: FluidPressure(header=header, fluid_pressure=value)),
    (PRESSURE_B, "pressure_b", 0.0, lambda header, value: FluidPressure(header=header, fluid_pressure=value)),
    (OIL_TEMPERATURE, "oil_temperature", ZERO_CELSIUS, lambda header, value: Temperature(header=header, temperature=value)),
)
"""Telemetry topics, each with its signal, the offset subtracted from it and the message constructor."""

MARK = 1234.5678
"""Placeholder for the value in an example message."""

JOINT_SIGNALS = {"position": "position", "velocity": "velocity", "effort": "force"}
"""Signals by field of ``joint_states``."""


class _Signal(NamedTuple):
    """One reading, its message and its publisher."""

    place: int
    zero: float
    template: Template
    publisher: Any


class Telemetry:
    """Publishes the rig's readings at the telemetry rate; failed readings are left out."""

    def __init__(self, node: Node, rate: float, measured: Collection[str]) -> None:
        """Create the publishers.

        Args:
            node: owner.
            rate: rate of each topic [Hz]; 0: none.
            measured: the signals that the rig measures.
        """
        self._node = node
        self._links = links_of(node)
        header = Header(frame_id=loader_frame(node.get_namespace()))
        self._single = [
            _Signal(
                EVERY_SENSED.index(signal),
                zero,
                Template(serialize_message(make(header, MARK)), [MARK], stamped=topic is not FORCE),
                node.create_publisher(message_class(topic.type), topic.name, 10),
            )
            for topic, signal, zero, make in MESSAGES
            if signal in measured
        ]
        self._header = header
        self._joints = node.create_publisher(JointState, JOINT_STATES.name, 10)
        self._joint_templates: dict[tuple[str, ...], Template] = {}
        self._period = 1.0 / rate if rate > 0.0 else float("inf")
        self._next = 0.0 if rate > 0.0 else float("inf")

    def publish(self, time_s: float, stamp_ns: int, measured: Sequence[float]) -> None:
        """Publish if due, on topics that have readers; nothing is kept for late joiners.

        Args:
            time_s: plant time [s].
            stamp_ns: its stamp [ns].
            measured: readings in the order of ``EVERY_SENSED``; NaN if not available.
        """
        if time_s < self._next:
            return
        self._next += self._period
        for place, zero, template, publisher in self._single:
            value = measured[place]
            if not math.isnan(value) and publisher.get_subscription_count():
                self._publish(publisher, template, stamp_ns, [value - zero])
        if self._joints.get_subscription_count():
            readings = {field: measured[EVERY_SENSED.index(signal)] for field, signal in JOINT_SIGNALS.items()}
            known = {field: value for field, value in readings.items() if not math.isnan(value)}
            template = self._joint_templates.get(tuple(known)) or self._joint_template(tuple(known))
            self._publish(self._joints, template, stamp_ns, list(known.values()))

    def _publish(self, publisher: Any, template: Template, stamp_ns: int, values: Sequence[float]) -> None:
        """Publish at once, or with the gathered messages if the node shares its process."""
        if self._links is None:
            publisher.handle.publish_raw(template(stamp_ns, values))
        else:
            self._links.later(publisher.handle.publish_raw, template, (stamp_ns, values))

    def _joint_template(self, known: tuple[str, ...]) -> Template:
        """Return the template of the joint message with some of its fields."""
        marks = [MARK + number for number in range(len(known))]
        fields = {field: [mark] for field, mark in zip(known, marks, strict=True)}
        message = JointState(header=self._header, name=[JOINT], **fields)
        self._joint_templates[known] = Template(serialize_message(message), marks, stamped=True)
        return self._joint_templates[known]

    def destroy(self) -> None:
        """Destroy the publishers after the gathered messages are published."""
        if self._links is not None:
            self._links.publish()
        for publisher in (self._joints, *(signal.publisher for signal in self._single)):
            self._node.destroy_publisher(publisher)


def time_of(stamp_ns: int) -> Time:
    """Return a stamp in nanoseconds as a message."""
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)
