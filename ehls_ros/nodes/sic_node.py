"""`sic_node`: structure invariance compensation."""

import sys

from ehls_ros.nodes.control import run_node
from ehls_ros.nodes.controller import ControllerNode


def main() -> int:
    """Run the node."""
    return run_node(lambda: ControllerNode("sic"))


if __name__ == "__main__":
    sys.exit(main())
