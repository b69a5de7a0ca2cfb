"""Round trip between two processes, for `ehls doctor`: `python -m ehls_ros.nodes.round_trip answer`, or `ask SECONDS`."""

import sys
import time

import rclpy
from std_msgs.msg import Float64

TRIPS = 100
"""Number of round trips measured."""


def answer() -> None:
    """Echo every message until the process is terminated."""
    rclpy.init()
    node = rclpy.create_node("ehls_doctor_echo")
    publisher = node.create_publisher(Float64, "ehls_doctor_back", 10)
    node.create_subscription(Float64, "ehls_doctor_there", publisher.publish, 10)
    rclpy.spin(node)


def ask(seconds: float) -> None:
    """Print the median round trip [s]; an empty line if no answer comes in time.

    Args:
        seconds: longest time for discovery and all round trips [s].
    """
    rclpy.init()
    node = rclpy.create_node("ehls_doctor")
    trips: list[float] = []
    publisher = node.create_publisher(Float64, "ehls_doctor_there", 10)

    def back(message: Float64) -> None:
        trips.append(time.perf_counter() - message.data)

    node.create_subscription(Float64, "ehls_doctor_back", back, 10)
    deadline = time.monotonic() + seconds
    while len(trips) < TRIPS and time.monotonic() < deadline:
        publisher.publish(Float64(data=time.perf_counter()))
        rclpy.spin_once(node, timeout_sec=0.05)
    print(sorted(trips)[len(trips) // 2] if trips else "", flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "answer":
        answer()
    else:
        ask(float(sys.argv[2]))
