"""The rclpy nodes: parameters, messages and timing. The computations are in the other packages.

Each node is one file, but all controllers share ``controller_process``: the module ``ehls_ros.nodes.<name>_node`` exists
for every installed controller, as if it had a file of that name.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from ehls_ros.control.controllers import CONTROLLERS

SUFFIX = "_node"

WITHOUT_MESSAGES = (
    "ehls_msgs, the messages of ehls_ros, is not there: `. install/setup.bash` of the workspace; if it is not built, "
    "`ln -sfn ehls_ros/ehls_msgs src/ehls_msgs && colcon build --packages-up-to ehls_ros`"
)


def node_names() -> tuple[str, ...]:
    """Return the names of all nodes, those of installed controllers included, sorted."""
    files = {module.name for module in iter_modules(__path__) if module.name.endswith(SUFFIX)}
    return tuple(sorted(files | {name + SUFFIX for name in CONTROLLERS.names()}))


def controller_of(node: str) -> str | None:
    """Return the controller that a node runs, or None."""
    name = node.removesuffix(SUFFIX)
    return name if node.endswith(SUFFIX) and name in CONTROLLERS.names() else None


class _ControllerNodes:
    """Module finder for controllers' nodes: maps each node name to the file of the controller process."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        parent, _, node = name.rpartition(".")
        if parent != __name__ or controller_of(node) is None:
            return None
        return spec_from_file_location(name, Path(__file__).with_name("controller_process.py"))


class _NoMessages:
    """Last-resort finder for ehls_msgs: raises an error that explains how to build it."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> None:
        if name == "ehls_msgs":
            raise ModuleNotFoundError(WITHOUT_MESSAGES, name=name)


sys.meta_path += [_ControllerNodes, _NoMessages]
