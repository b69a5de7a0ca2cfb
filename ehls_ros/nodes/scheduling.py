"""Scheduling of a node's process: real-time priority, processors, and the limit of the processor time of its loop."""

import os
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING

from ehls_ros.hardware.processor_demand import ProcessorDemand, statistics_of
from ehls_ros.hardware.realtime import claim, keep_to, processors_of

if TYPE_CHECKING:
    from ehls_ros.nodes.control import ControlNode


class Scheduling:
    """Claims the scheduling that the parameters request.

    Attributes:
        not_permitted: requests that the system refused.
        processor_demand: limit of the processor time; None without a priority.
    """

    def __init__(self, node: "ControlNode") -> None:
        """Read the parameters.

        Raises:
            BadInput: there is no such processor.
        """
        self._node = node
        self._processors = processors_of(node.text_parameter("processors"), node.get_name())
        self.not_permitted: tuple[str, ...] = ()
        self.processor_demand: ProcessorDemand | None = None

    def claim(self) -> None:
        """Claim priority and processors; called once the node's receiver threads exist."""
        node = self._node
        # The middleware's receiver threads hold locks that senders need too. Even if the loop itself runs at a lower
        # priority, its receivers must not be preempted while they hold one.
        loops = (
            ()
            if node.answers or node.links is not None
            else [thread.native_id for thread in threading.enumerate() if thread.native_id]
        )
        priority = 0 if node.lockstep or node.background else int(node.get_parameter("priority").value)
        self.not_permitted = claim(priority, loops)
        if self._processors and not node.hosted:
            keep_to(self._processors)
        if priority and not node.hosted:
            # The loop runs in the main thread, whose id is that of the process.
            self.processor_demand = ProcessorDemand(
                float(node.get_parameter("processor_share").value), statistics_of(os.getpid())
            )

    def release(self) -> None:
        """Stop limiting the processor time."""
        if self.processor_demand is not None:
            self.processor_demand.close()
            self.processor_demand = None

    @property
    def complaint(self) -> str:
        """Reason for giving up the priority; empty while it is not given up."""
        return "" if self.processor_demand is None else self.processor_demand.complaint

    def figures(self) -> Mapping[str, float]:
        """Return values for diagnostics."""
        return {} if self.processor_demand is None else self.processor_demand.figures()
