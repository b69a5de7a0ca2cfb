"""Assignment of nodes to shared processes and their order of activation; :mod:`ehls_ros.nodes.composed` runs them."""

from collections.abc import Sequence

from ehls_ros.errors import BadInput, one_of
from ehls_ros.nodes import controller_of, node_names

PLUS = "+"
"""Separator between the names of nodes that share a process."""

BEFORE = ("reference_node", "disturbance_node", "friction_estimator_node")
"""Nodes that provide a controller's inputs, in order of activation; the controller's comes next."""

HOSTS = ("plant_sim_node", "hardware_bridge_node")
"""Nodes whose loop runs the others; one of them is required, and is activated last."""


def may_be_together(name: str) -> bool:
    """Return whether a node can share a process with others."""
    return name in BEFORE or name in HOSTS or controller_of(name) is not None


def processes_of(names: Sequence[str], *, compose: bool) -> list[str]:
    """Return the processes that run a graph's nodes.

    Args:
        names: of the nodes, in order of activation; the plant comes last.
        compose: whether nodes that can share a process do, named ``first+second+…``.
    """
    together = [name for name in names if compose and may_be_together(name)]
    if not set(together) & set(HOSTS):
        return list(names)
    return [*(name for name in names if name not in together), PLUS.join(together)]


def in_order(names: Sequence[str]) -> list[str]:
    """Return the names of the nodes of one process in order of activation.

    Raises:
        BadInput: these nodes cannot be one process, or one of them does not exist.
    """
    where, known = PLUS.join(names), node_names()
    for name in names:
        if name not in known:
            raise BadInput(f"there is no node '{name}'", where, one_of(name, known))
        if not may_be_together(name):
            raise BadInput(f"{name} cannot share a process", where, f"{', '.join((*BEFORE, *HOSTS))} or a controller's node")
    hosts, laws = [name for name in names if name in HOSTS], [name for name in names if controller_of(name) is not None]
    if len(hosts) != 1:
        raise BadInput(f"{len(hosts)} plant nodes are named", where, f"one of {', '.join(HOSTS)}")
    if len(laws) > 1:
        raise BadInput(f"{len(laws)} controllers are named", where, "one; another that stands by is a process of its own")
    if len(set(names)) < len(names):
        raise BadInput("a node is named twice", where, "each once")
    return [*(name for name in BEFORE if name in names), *laws, *hosts]
