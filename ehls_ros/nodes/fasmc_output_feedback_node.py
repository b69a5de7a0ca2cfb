"""`fasmc_output_feedback_node`: sliding mode force control from what a rig measures."""

from typing import NoReturn

from ehls_ros.nodes.control import run_node
from ehls_ros.nodes.controller import ControllerNode


def main() -> NoReturn:
    """Run the node."""
    run_node(lambda: ControllerNode("fasmc_output_feedback"))


if __name__ == "__main__":
    main()
