"""`disturbance_node`: publishes the force of the actuator under test, or its reference if it is a position servo."""

from typing import Any, NoReturn

from ehls_msgs.msg import Disturbance
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.experiments.loop import sampled
from ehls_ros.nodes.ahead import AheadNode
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.transport import Outbox
from ehls_ros.recording.topics import DISTURBANCE, SERVO_REFERENCE


class DisturbanceNode(AheadNode):
    """Publishes the spec's disturbance, or the reference of a servo whose motion the plant simulates and publishes."""

    def __init__(self) -> None:
        """Choose the topic."""
        super().__init__("disturbance_node")
        self.topic = SERVO_REFERENCE if DISTURBANCES.load(self.spec.disturbance.name).REACTS else DISTURBANCE
        self.source: Any

    def open_outbox(self) -> Outbox:
        """Build the disturbance and open the topic."""
        use, period = self.spec.disturbance, self.spec.settings.control_period
        kind = DISTURBANCES.load(use.name)
        self.source = kind.build(use.parameters, sampled(use.signal, period), self.spec.rig, period)
        return Outbox(self, Disturbance, self.topic.name)

    def row(self, cycle: int) -> list[float]:
        """Return force, its rate, displacement and velocity."""
        row: list[float] = self.source.rows(cycle, 1)[0].tolist()
        return row


def main() -> NoReturn:
    """Run the node."""
    run_node(DisturbanceNode)


if __name__ == "__main__":
    main()
