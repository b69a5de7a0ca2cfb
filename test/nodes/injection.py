"""An exception raised on purpose in one method of a node's class, in the process that runs the node."""

import functools
import inspect
import itertools
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from ehls_ros.hardware.backends.udp import UdpDevice
from ehls_ros.nodes.diagnostics import Diagnostics
from ehls_ros.nodes.gate_services import GateServices
from ehls_ros.nodes.graph_nodes import PLANTS
from ehls_ros.nodes.lifecycle import Lifecycle, transition
from ehls_ros.nodes.loop import Loop
from ehls_ros.nodes.scheduling import Scheduling

CLASSES = {
    "plant_sim_node": "ehls_ros.nodes.plant_sim_node.PlantSimNode",
    "hardware_bridge_node": "ehls_ros.nodes.hardware_bridge_node.HardwareBridgeNode",
    "reference_node": "ehls_ros.nodes.reference_node.ReferenceNode",
    "programme_node": "ehls_ros.nodes.programme_node.ProgrammeNode",
    "disturbance_node": "ehls_ros.nodes.disturbance_node.DisturbanceNode",
    "friction_estimator_node": "ehls_ros.nodes.friction_estimator_node.FrictionEstimatorNode",
    "fasmc_node": "ehls_ros.nodes.controller.ControllerNode",
    "fasmc_output_feedback_node": "ehls_ros.nodes.controller.ControllerNode",
    "recorder_node": "ehls_ros.nodes.recorder_node.RecorderNode",
    "monitor_node": "ehls_ros.nodes.monitor_node.MonitorNode",
}

OF_ALL = (Lifecycle, Loop, Scheduling, Diagnostics)
OF_PLANTS = (GateServices,)
PARTS: dict[str, type] = {part.__name__: part for part in (*OF_ALL, *OF_PLANTS)}
"""Objects that every node, or every plant, is composed of; their methods are named ``Part.method``."""

BASES = "ehls_ros.nodes."
"""Classes of other modules, such as rclpy's, are excluded."""


class Injected(Exception):
    """The exception; no code of the project can expect it."""


def class_of(node: str) -> type:
    """Return the class of a node."""
    module, _, name = CLASSES[node].rpartition(".")
    found: type = getattr(import_module(module), name)
    return found


def methods_of(node: str) -> Iterator[str]:
    """Yield the names of all methods of a node's class and its parts that are defined in this project."""
    seen = set()
    for base in class_of(node).__mro__:
        if not base.__module__.startswith(BASES):
            continue
        for name, member in vars(base).items():
            if inspect.isfunction(member) and name not in seen:
                seen.add(name)
                yield name
    for kind in (*OF_ALL, *(OF_PLANTS if node in PLANTS.values() else ())):
        yield from (f"{kind.__name__}.{name}" for name, member in vars(kind).items() if inspect.isfunction(member))


def inject(node: str, method: str, call: int, mark: str, writes: str = "") -> None:
    """Make a method of a node raise.

    Args:
        node: name of the node.
        method: name of the method, or of a part and its method.
        call: number of the call that raises, counted from 1.
        mark: file that is created just before.
        writes: file to which each command for a device is written; empty: none.
    """
    if writes:
        _record_commands(Path(writes))
    part, _, name = method.rpartition(".")
    owner = PARTS[part] if part else class_of(node)
    decorated = inspect.getattr_static(owner, name)
    original = inspect.unwrap(decorated)
    counted = itertools.count(1)

    @functools.wraps(original)
    def raising(self: Any, *arguments: Any, **words: Any) -> Any:
        of_node = not part or isinstance(_node_of(self, arguments), class_of(node))
        if of_node and next(counted) == call:
            Path(mark).touch()
            raise Injected(method)
        return original(self, *arguments, **words)

    # Reapply a transition's guard around the raising method, so that it handles the exception.
    setattr(owner, name, raising if decorated is original else transition(raising))


def _node_of(part: Any, arguments: tuple[Any, ...]) -> Any:
    """Return the node of a part, whose constructor receives it."""
    found = getattr(part, "node", None) or getattr(part, "_node", None)
    return arguments[0] if found is None else found


def _record_commands(path: Path) -> None:
    """Record the commands that reach the socket of a device."""
    send = UdpDevice.write

    def write(device: UdpDevice, value: float, sequence: int) -> None:
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{value}\n")
        send(device, value, sequence)

    setattr(UdpDevice, "write", write)  # noqa: B010
