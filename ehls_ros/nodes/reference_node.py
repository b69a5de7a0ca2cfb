"""`reference_node`: the reference force or position and its derivatives, whichever the spec's controller follows."""

from typing import Any, NoReturn

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.experiments.loop import sampled
from ehls_ros.nodes.ahead import AheadNode
from ehls_ros.nodes.control import run_node
from ehls_ros.nodes.transport import Outbox, message_class
from ehls_ros.recording.topics import REFERENCE_TOPICS


class ReferenceNode(AheadNode):
    """Publishes the spec's reference."""

    def __init__(self) -> None:
        """Name the node."""
        super().__init__("reference_node")

    def open_outbox(self) -> Outbox:
        """Open the topic."""
        self.signal = sampled(self.spec.reference, self.spec.settings.control_period)
        topic = REFERENCE_TOPICS[CONTROLLERS.load(self.spec.controller.name).FOLLOWS]
        return Outbox(self, message_class(topic.type), topic.name)

    def row(self, cycle: int, state: tuple[Any, ...] | None) -> list[float]:
        """Return the reference and its first and second derivative."""
        row: list[float] = self.signal.row(cycle).tolist()
        return row


def main() -> NoReturn:
    """Run the node."""
    run_node(ReferenceNode)


if __name__ == "__main__":
    main()
