"""Several nodes in one process, with a control cycle as one call: `ehls run plant_sim_node+fasmc_node+…`.

The nodes keep the names, parameters, services and diagnostics that they have as separate processes. The plant's loop runs in
the main thread. Where it would wait, the others react to the messages handed over, estimator before controller, and the
command returns before anything is published. Messages for other readers are published afterwards.
"""

import gc
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NoReturn

from ehls_ros.errors import BadInput
from ehls_ros.experiments.graph_check import Graph, check_fit
from ehls_ros.nodes import controller_of
from ehls_ros.nodes.control import ControlNode
from ehls_ros.nodes.controller import ControllerNode
from ehls_ros.nodes.disturbance_node import DisturbanceNode
from ehls_ros.nodes.friction_estimator_node import FrictionEstimatorNode
from ehls_ros.nodes.graph_nodes import PLUS, in_order
from ehls_ros.nodes.hardware_bridge_node import HardwareBridgeNode
from ehls_ros.nodes.links import Links
from ehls_ros.nodes.loop import WAIT, reduce_wake_up_delays
from ehls_ros.nodes.plant_sim_node import PlantSimNode
from ehls_ros.nodes.reference_node import ReferenceNode
from ehls_ros.nodes.running import run_nodes
from ehls_ros.nodes.transport import Waiter
from ehls_ros.process import Stopping, end
from ehls_ros.recording.topics import DEPTH

NODES: Mapping[str, Callable[[], ControlNode]] = MappingProxyType(
    {
        "reference_node": ReferenceNode,
        "disturbance_node": DisturbanceNode,
        "friction_estimator_node": FrictionEstimatorNode,
        "plant_sim_node": PlantSimNode,
        "hardware_bridge_node": HardwareBridgeNode,
    }
)
"""Nodes that can share a process, besides the controllers'."""

BATCH = 20
"""Messages that are published in one batch, those of four cycles: published singly, each would wake up its readers. Not used
where a node of another process takes part in the cycles."""

LOCKSTEP_BATCH = 100
"""The same in lockstep."""

KEPT_IN_LOCKSTEP = 5 * DEPTH
"""History depth of a topic in lockstep: some thousand cycles may pass before a recorder on a busy machine reads."""


def _maker(name: str) -> Callable[[], ControlNode]:
    law = controller_of(name)
    return NODES[name] if law is None else lambda: ControllerNode(law)


class Composition:
    """Runs the loops of several nodes in one thread."""

    def __init__(self, nodes: Sequence[ControlNode]) -> None:
        """Connect the nodes.

        Args:
            nodes: in the order in which they become active; the last is the plant.
        """
        *partners, self._host = nodes
        self._answering = [node for node in partners if node.answers]
        self._ahead = [node for node in partners if not node.answers]
        lockstep = self._host.lockstep
        kept, period = KEPT_IN_LOCKSTEP if lockstep else self._host.cycles_kept, self._host.spec.settings.control_period
        self._links = Links(self._wait, kept, patient=lockstep, period=period)
        self._inside = False
        # The node whose code is running, to which an exception is attributed.
        self._acting: ControlNode = self._host
        for node in nodes:
            node.links = self._links
        for node in partners:
            node.be_hosted()
        # The plant starts last and stops first: the others are ready before its first request and may end after its last.
        self._beginning, self._ending = list(nodes), [self._host, *partners]
        self._batch = LOCKSTEP_BATCH if lockstep else BATCH

    def run(self, stopping: Stopping) -> None:
        """Run the loops of the active nodes until an event is set."""
        reduce_wake_up_delays()
        for node in self._beginning:
            node.loop.serve()
        gc.disable()
        try:
            while not stopping.is_set():
                self._follow_lifecycle()
                if self._host.loop.running:
                    self._host.once()
                    self._host.loop.supervise()
                    if not self._links.open:
                        # A bridge has handed the command to the rig and has time until the next sample.
                        self._react(self._ahead)
                        self._publish_batch()
                else:
                    self._turn_without_plant()
        except Exception as error:  # noqa: BLE001
            self._acting.report_failure(error, "loop")
        finally:
            gc.enable()
            for node in self._ending:
                if node.loop.running:
                    node.loop.leave()

    def _follow_lifecycle(self) -> None:
        """Begin and end the loops of the nodes that have become active or inactive."""
        if all(node.loop.running and node.loop.is_active for node in self._ending):
            return
        for node in self._ending:
            if node.loop.running and not node.loop.is_active:
                node.loop.leave()
        for node in self._beginning:
            if node.loop.is_active and not node.loop.running:
                self._acting = node
                node.loop.enter()
                self._acting = self._host
            elif not node.loop.running:
                node.loop.settle()

    def _turn_without_plant(self) -> None:
        self._react(self._answering)
        self._react(self._ahead)
        self._links.publish()
        self._block([], WAIT)

    def _react(self, nodes: Sequence[ControlNode]) -> bool:
        """Let nodes react to the messages that have arrived; return whether any did."""
        self._inside = True
        reacted = False
        try:
            for node in nodes:
                self._acting = node
                if node.loop.running and node.react():
                    reacted = True
            self._acting = self._host
        finally:
            self._inside = False
        return reacted

    def _wait(self, waiter: Waiter, seconds: float) -> None:
        """Run the other nodes in place of waiting; wait for other processes once nothing is left to do."""
        if self._inside:
            if not waiter.arrived:
                waiter.block(seconds)
            return
        if self._links.open or self._links.apart:
            self._react(self._answering)
        if waiter.arrived:
            if self._host.lockstep:
                self._publish_batch()
            return
        # After the answer to the snapshot, the end of the previous turn did this.
        if self._links.open:
            if self._react(self._ahead):
                return
            # The awaited message may have to come from another process.
            self._links.publish()
        self._block([waiter], seconds)

    def _publish_batch(self) -> None:
        """Publish if enough messages have gathered or another process takes part; not between a snapshot and its answer."""
        if self._links.apart or self._links.pending >= self._batch:
            self._links.publish()

    def _block(self, waiters: Sequence[Waiter], seconds: float) -> None:
        """Wait for a message of another process for any of the nodes, at most for a time [s]."""
        self._links.begin_pause(seconds)
        waiters = [*waiters, *(node.awaited_inputs() for node in self._answering if node.loop.running)]
        if waiters:
            waiters[0].block(seconds, waiters[1:])
        else:
            time.sleep(seconds)


def run_composed(names: Sequence[str]) -> NoReturn:
    """Run nodes as one process.

    Args:
        names: of the nodes, in any order.
    """
    try:
        makes = [_maker(name) for name in in_order(names)]
    except BadInput as error:
        print(error, file=sys.stderr)
        end(2)
    run_nodes(makes, lambda nodes: Composition(nodes).run, _check)


def _check(nodes: Sequence[ControlNode]) -> None:
    """Check that plant and law fit together; remarks go to the log.

    Raises:
        BadInput: they do not.
    """
    host = nodes[-1]
    bridge = host.bridge if isinstance(host, HardwareBridgeNode) else None
    for law in (node.law for node in nodes if isinstance(node, ControllerNode)):
        for remark in check_fit(host.spec, Graph(law, bridge, lockstep=host.lockstep), host.get_name()):
            host.get_logger().info(remark)


def main() -> NoReturn:
    """Run the nodes that the command line names before `--ros-args`."""
    given = sys.argv[1:]
    names = given[: given.index("--ros-args")] if "--ros-args" in given else given
    run_composed([name for word in names for name in word.split(PLUS)])


if __name__ == "__main__":
    main()
