"""Process of one controller, selected by the module's name ``ehls_ros.nodes.<name>_node``."""

from typing import NoReturn

from ehls_ros.nodes import controller_of
from ehls_ros.nodes.controller import ControllerNode
from ehls_ros.nodes.running import run_node


def main() -> NoReturn:
    """Run the node."""
    # With `python -m` the module is called __main__, but its spec keeps the name.
    name = __spec__.name.rpartition(".")[2]
    controller = controller_of(name)
    if controller is None:
        raise ImportError(f"{name} is not the node of a controller: import ehls_ros.nodes.<name>_node")
    run_node(lambda: ControllerNode(controller))


if __name__ == "__main__":
    main()
