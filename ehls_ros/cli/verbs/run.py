"""`ehls run`: start one node, without `ros2 run`, or several as one process."""

import sys
from argparse import REMAINDER, ArgumentParser, Namespace
from importlib import import_module

from ehls_ros.cli.arguments import needs_ros
from ehls_ros.nodes import node_names
from ehls_ros.nodes.graph_nodes import PLUS, in_order

HELP = "Start one node, as `ros2 run ehls_ros NODE` does, or several as one process."


class _Joinable(tuple[str, ...]):
    """Names of nodes, single or joined by PLUS."""

    __slots__ = ()

    def __contains__(self, names: object) -> bool:
        """Return whether this is a node's name or several joined names, which are checked one by one later."""
        return PLUS in str(names) or tuple.__contains__(self, names)


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    about = f"node to start, or several for one process: plant_sim_node{PLUS}friction_estimator_node{PLUS}fasmc_node"
    parser.add_argument("node", choices=_Joinable(node_names()), help=about)
    parser.add_argument("ros_arguments", nargs=REMAINDER, help="arguments of ROS, such as --ros-args -p k:=14.0")


def run(options: Namespace) -> int:
    """Start the nodes, and return the exit code."""
    names = options.node.split(PLUS)
    together = len(names) > 1
    names = in_order(names) if together else names
    with needs_ros():
        node = import_module(f"ehls_ros.nodes.{'composed' if together else names[0]}")
    sys.argv = [*(["composed"] if together else []), *names, *options.ros_arguments]
    code: int = node.main()
    return code
