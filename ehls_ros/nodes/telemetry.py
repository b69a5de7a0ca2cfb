"""The loader's signals as standard messages at a low rate, for common ROS tools."""

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import FluidPressure, JointState, Temperature
from std_msgs.msg import Float64, Header

from ehls_ros.nodes.codec import NANOSECONDS
from ehls_ros.nodes.frames import JOINT, loader_frame
from ehls_ros.nodes.transport import message_class
from ehls_ros.physics.rig import SENSED
from ehls_ros.recording.topics import FORCE, JOINT_STATES, LOAD_PRESSURE, OIL_TEMPERATURE, SUPPLY_PRESSURE, WRENCH, Topic

ZERO_CELSIUS = 273.15
"""0 °C [K]."""

MESSAGES: tuple[tuple[Topic, str, Callable[[Header, float], Any]], ...] = (
    (FORCE, "force", lambda header, value: Float64(data=value)),
    (WRENCH, "force", lambda header, value: WrenchStamped(header=header, wrench=Wrench(force=Vector3(x=value)))),
    (LOAD_PRESSURE, "load_pressure", lambda header, value: FluidPressure(header=header, fluid_pressure=value)),
    (SUPPLY_PRESSURE, "supply_pressure", lambda header, value: FluidPressure(header=header, fluid_pressure=value)),
    (OIL_TEMPERATURE, "oil_temperature", lambda header, value: Temperature(header=header, temperature=value - ZERO_CELSIUS)),
)
"""Topics of one signal of ``SENSED`` each, and how its message is made."""

JOINT_SIGNALS = {"position": "position", "velocity": "velocity", "effort": "force"}
"""Signals by field of ``joint_states``."""


class Telemetry:
    """Publishes what the rig measures at the telemetry rate; a reading that fails is left out."""

    def __init__(self, node: Node, rate: float, measured: Collection[str]) -> None:
        """Create the publishers.

        Args:
            node: owner.
            rate: rate of each topic [Hz]; 0: none.
            measured: the signals of ``SENSED`` that the rig measures.
        """
        self._node = node
        self._frame = loader_frame(node.get_namespace())
        self._single = [
            (SENSED.index(signal), make, node.create_publisher(message_class(topic.type), topic.name, 10))
            for topic, signal, make in MESSAGES
            if signal in measured
        ]
        self._joints = node.create_publisher(JointState, JOINT_STATES.name, 10)
        self._period = 1.0 / rate if rate > 0.0 else float("inf")
        self._next = 0.0 if rate > 0.0 else float("inf")

    def tell(self, time_s: float, stamp_ns: int, measured: Sequence[float]) -> None:
        """Publish if due.

        Args:
            time_s: plant time [s].
            stamp_ns: its stamp [ns].
            measured: readings in the order of ``SENSED``; NaN where there is none.
        """
        if time_s < self._next:
            return
        self._next += self._period
        header = Header(stamp=time_of(stamp_ns), frame_id=self._frame)
        for index, make, publisher in self._single:
            value = measured[index]
            if not math.isnan(value):
                publisher.publish(make(header, value))
        readings = {field: measured[SENSED.index(signal)] for field, signal in JOINT_SIGNALS.items()}
        known = {field: [value] for field, value in readings.items() if not math.isnan(value)}
        self._joints.publish(JointState(header=header, name=[JOINT], **known))

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in (self._joints, *(publisher for _, _, publisher in self._single)):
            self._node.destroy_publisher(publisher)


def time_of(stamp_ns: int) -> Time:
    """Return a stamp in nanoseconds as a message."""
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)
