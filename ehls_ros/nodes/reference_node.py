"""`reference_node`: publishes the reference force or position, as the spec's controller requires, and its derivatives."""

import math
from typing import Annotated, NamedTuple, NoReturn

from ehls_msgs.msg import LoaderState
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.references._signals import eased_in
from ehls_ros.control.references.base import SampledReference
from ehls_ros.experiments.loop import sampled
from ehls_ros.nodes.ahead import AheadNode
from ehls_ros.nodes.parameters import declare
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, message_class
from ehls_ros.physics import sensors
from ehls_ros.recording.topics import REFERENCE_TOPICS
from ehls_ros.schema import quantity

MEASURED = {"force": sensors.FORCE, "position": sensors.POSITION}
"""Index of the reading that a controller follows."""


class Parameters(NamedTuple):
    """Start of the reference."""

    start_time: Annotated[
        float,
        quantity("s", "time in which the reference is led in from where the rig is; 0: it begins at once", minimum=0.0),
    ] = 0.0


class ReferenceNode(AheadNode):
    """Publishes the spec's reference."""

    publishes_actuator = True

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("reference_node")
        declare(self, Parameters, live=False)
        self.start_time = float(self.get_parameter("start_time").value)
        self.follows = CONTROLLERS.load(self.spec.controller.name).FOLLOWS
        # First cycle of the reference, and the value that it is led in from.
        self.began = 0
        self.initial = math.nan
        # Made by `open_outbox`:
        self.signal: SampledReference
        self.states: Inbox | None
        self.first_state: Waiter

    def open_outbox(self) -> Outbox:
        """Open the topic."""
        self.signal = sampled(self.spec.reference, self.spec.settings.control_period)
        self.began, self.initial = 0, math.nan
        self.states = Inbox(self, LoaderState, "loader_state") if self.start_time > 0.0 else None
        if self.states is not None:
            self.first_state = Waiter([self.states])
        topic = REFERENCE_TOPICS[self.follows]
        return Outbox(self, message_class(topic.type), topic.name)

    def release(self) -> None:
        """Close the topics."""
        self._close_states()
        super().release()

    def start(self) -> None:
        """Publish the rows needed before the first snapshot, unless that snapshot determines where they begin."""
        if self.states is None:
            super().start()

    def awaited_inputs(self) -> Waiter:
        """Return the waiter for the newest cycle, preceded by that for the rig's position."""
        return self.waiter if self.states is None else self.first_state

    def react(self) -> bool:
        """Determine the rig's position, then publish ahead of the newest cycle."""
        if self.states is None:
            return super().react()
        newest = None
        while (state := self.states.take()) is not None:
            newest = state
        if newest is None:
            return False
        self.next = self.began = newest[1]
        self.initial = newest[2 + MEASURED[self.follows]]
        self._close_states()
        self.start()
        return True

    def _close_states(self) -> None:
        if self.states is not None:
            self.first_state.destroy()
            self.states.destroy()
            self.states = None

    def row(self, cycle: int) -> list[float]:
        """Return the reference and its first and second derivative."""
        row: list[float] = self.signal.row(cycle).tolist()
        since = (cycle - self.began) * self.spec.settings.control_period
        if math.isnan(self.initial) or not 0.0 <= since < self.start_time:
            return row
        return eased_in(row, self.initial, since, self.start_time)


def main() -> NoReturn:
    """Run the node."""
    run_node(ReferenceNode)


if __name__ == "__main__":
    main()
