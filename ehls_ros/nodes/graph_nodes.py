"""The nodes of a graph: those that an experiment needs, their order of activation, and the processes that they share.

Used by the launch file, :mod:`ehls_ros.nodes.graph`, which runs an experiment, and :mod:`ehls_ros.nodes.composed`, which runs
several nodes as one process.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.errors import BadInput, one_of
from ehls_ros.nodes import SUFFIX, controller_of, node_names

if TYPE_CHECKING:
    from ehls_ros.experiments.spec import Spec

LOCKSTEP, REALTIME = TIMINGS = ("lockstep", "realtime")
"""Timing modes."""

PLANTS = {"sim": "plant_sim_node", "fmu": "plant_sim_node", "bridge": "hardware_bridge_node"}
"""Plant nodes. An FMU stands in place of the simulator. With the bridge, the disturbance acts on the rig itself, so there is
no disturbance node."""

RECORDER, MONITOR = "recorder_node", "monitor_node"

REFERENCE, PROGRAMME = "reference_node", "programme_node"
"""Nodes of the reference; the second one runs a test programme."""

DISTURBANCE, ESTIMATOR = "disturbance_node", "friction_estimator_node"

BACKGROUND = (RECORDER, REFERENCE, PROGRAMME, DISTURBANCE)
"""Nodes whose output no cycle awaits; they run at lower priority."""

COMPOSED = "composed"
"""Module that runs several nodes as one process."""

PLUS = "+"
"""Separator between the names of nodes that share a process."""

INPUTS = (REFERENCE, DISTURBANCE, ESTIMATOR)
"""Nodes that provide a controller's inputs and can share its process, in order of activation; the controller's comes next."""

HOSTS = tuple(dict.fromkeys(PLANTS.values()))
"""Nodes whose loop runs the others of a shared process; one of them is required, and is activated last."""


def reference_node(spec: "Spec") -> str:
    """Return the node that publishes a spec's reference."""
    return PROGRAMME if spec.reference.name == "programme" else REFERENCE


def nodes_of(
    spec: "Spec",
    plant: str,
    law: str = "",
    *,
    record: bool = True,
    monitor: bool = False,
    programme: bool = False,
    estimate: bool = False,
) -> list[str]:
    """Return the nodes that an experiment needs, in order of activation; the plant comes last.

    Args:
        spec: the experiment.
        plant: key of :data:`PLANTS`.
        law: controller; empty: the spec's.
        record: whether the run is recorded.
        monitor: whether the rig's health is watched.
        programme: whether a test programme replaces the spec's reference.
        estimate: whether friction is estimated even if the controller does not need that; another on standby may.
    """
    law = law or spec.controller.name
    needed = {
        RECORDER: record,
        PROGRAMME if programme else reference_node(spec): True,
        DISTURBANCE: plant != "bridge",
        ESTIMATOR: estimate or CONTROLLERS.load(law).FRICTION,
        law + SUFFIX: True,
        MONITOR: monitor,
        PLANTS[plant]: True,
    }
    return [name for name, is_needed in needed.items() if is_needed]


def can_share(name: str) -> bool:
    """Return whether a node can share a process with others."""
    return name in INPUTS or name in HOSTS or controller_of(name) is not None


def processes_of(names: Sequence[str], *, compose: bool) -> list[str]:
    """Return the processes that run a graph's nodes.

    Args:
        names: of the nodes, in order of activation; the plant comes last.
        compose: whether nodes that can share a process do, named ``first+second+…``.
    """
    shared = [name for name in names if compose and can_share(name)]
    if not set(shared) & set(HOSTS):
        return list(names)
    return [*(name for name in names if name not in shared), PLUS.join(shared)]


def in_order(names: Sequence[str]) -> list[str]:
    """Return the names of the nodes of one process in order of activation.

    Raises:
        BadInput: these nodes cannot be one process, or one of them does not exist.
    """
    where, known = PLUS.join(names), node_names()
    for name in names:
        if name not in known:
            raise BadInput(f"there is no node '{name}'", where, one_of(name, known))
        if not can_share(name):
            raise BadInput(f"{name} cannot share a process", where, f"{', '.join((*INPUTS, *HOSTS))} or a controller's node")
    hosts, laws = [name for name in names if name in HOSTS], [name for name in names if controller_of(name) is not None]
    if len(hosts) != 1:
        raise BadInput(f"{len(hosts)} plant nodes are named", where, f"one of {', '.join(HOSTS)}")
    if len(laws) > 1:
        raise BadInput(f"{len(laws)} controllers are named", where, "one; another on standby is a separate process")
    if len(set(names)) < len(names):
        raise BadInput("a node is named twice", where, "each once")
    return [*(name for name in INPUTS if name in names), *laws, *hosts]
