"""`pid_node`: the rod along a wanted motion, for identification."""

from typing import NoReturn

from ehls_ros.nodes.control import run_node
from ehls_ros.nodes.controller import ControllerNode


def main() -> NoReturn:
    """Run the node."""
    run_node(lambda: ControllerNode("pid"))


if __name__ == "__main__":
    main()
