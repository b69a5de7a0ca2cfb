"""`disturbance_node`: the actuator under test, as a force or as a simulated position servo."""

from typing import Any, NoReturn

from ehls_msgs.msg import Disturbance
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.experiments.loop import sampled
from ehls_ros.nodes.ahead import LEAD, AheadNode
from ehls_ros.nodes.control import run_node
from ehls_ros.nodes.transport import Outbox
from ehls_ros.physics import sensors


class DisturbanceNode(AheadNode):
    """Publishes the spec's disturbance."""

    def __init__(self) -> None:
        """Choose the lead: a disturbance that reacts to the loader can run only one cycle ahead."""
        super().__init__("disturbance_node")
        self.lead = 1 if DISTURBANCES.load(self.spec.disturbance.name).REACTS else LEAD

    def open_outbox(self) -> Outbox:
        """Build the disturbance and open the topic."""
        use, period = self.spec.disturbance, self.spec.settings.control_period
        kind = DISTURBANCES.load(use.name)
        self.source = kind.build(use.parameters, sampled(use.signal, period), self.spec.rig, period)
        return Outbox(self, Disturbance, "disturbance")

    def row(self, cycle: int, state: tuple[Any, ...] | None) -> list[float]:
        """Return force, its rate, displacement and velocity."""
        if cycle == 0:
            first: list[float] = self.source.first().tolist()
            return first
        position = state[2 + sensors.POSITION] if state else 0.0
        velocity = state[2 + sensors.VELOCITY] if state else 0.0
        row: list[float] = self.source.following(cycle - 1, position, velocity).tolist()
        return row


def main() -> NoReturn:
    """Run the node."""
    run_node(DisturbanceNode)


if __name__ == "__main__":
    main()
