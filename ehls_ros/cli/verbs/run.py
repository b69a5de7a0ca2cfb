"""`ehls run`: start one node, where there is no `ros2 run`."""

import sys
from argparse import REMAINDER, ArgumentParser, Namespace
from importlib import import_module

from ehls_ros.errors import BadInput
from ehls_ros.nodes import node_names

HELP = "Start one node, as `ros2 run ehls_ros NODE` does."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("node", choices=node_names(), help="node to start")
    parser.add_argument("ros_arguments", nargs=REMAINDER, help="handed to ROS, such as --ros-args -p k:=14.0")


def run(options: Namespace) -> int:
    """Start it and return its exit code."""
    try:
        node = import_module(f"ehls_ros.nodes.{options.node}")
    except ImportError as error:
        raise BadInput(f"ROS 2 cannot be imported ({error})", "this Python", "ROS 2 Jazzy sourced, or `make setup`") from None
    sys.argv = [options.node, *options.ros_arguments]
    code: int = node.main()
    return code
