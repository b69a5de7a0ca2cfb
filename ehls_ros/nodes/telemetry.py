"""The loader's signals as standard messages at a low rate, for common ROS tools."""

from collections.abc import Sequence

from builtin_interfaces.msg import Time
from rclpy.node import Node
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64

from ehls_ros.nodes.codec import NANOSECONDS
from ehls_ros.physics import sensors


class Telemetry:
    """Publishes ``force``, ``load_pressure`` and ``joint_states`` at the telemetry rate."""

    def __init__(self, node: Node, rate: float) -> None:
        """Create the publishers.

        Args:
            node: owner.
            rate: rate of each topic [Hz]; 0: none.
        """
        self._node = node
        self._force = node.create_publisher(Float64, "force", 10)
        self._pressure = node.create_publisher(FluidPressure, "load_pressure", 10)
        self._joints = node.create_publisher(JointState, "joint_states", 10)
        self._period = 1.0 / rate if rate > 0.0 else float("inf")
        self._next = 0.0 if rate > 0.0 else float("inf")

    def tell(self, time_s: float, stamp_ns: int, measured: Sequence[float]) -> None:
        """Publish if due.

        Args:
            time_s: plant time [s].
            stamp_ns: its stamp [ns].
            measured: readings in the order of ``SENSED``.
        """
        if time_s < self._next:
            return
        self._next += self._period
        stamp = time_of(stamp_ns)
        self._force.publish(Float64(data=measured[sensors.FORCE]))
        pressure = FluidPressure(fluid_pressure=measured[sensors.LOAD_PRESSURE])
        joints = JointState(
            name=["loader"],
            position=[measured[sensors.POSITION]],
            velocity=[measured[sensors.VELOCITY]],
            effort=[measured[sensors.FORCE]],
        )
        pressure.header.stamp = joints.header.stamp = stamp
        pressure.header.frame_id = joints.header.frame_id = "loader"
        self._pressure.publish(pressure)
        self._joints.publish(joints)

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in (self._force, self._pressure, self._joints):
            self._node.destroy_publisher(publisher)


def time_of(stamp_ns: int) -> Time:
    """Return a stamp in nanoseconds as a message."""
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)
