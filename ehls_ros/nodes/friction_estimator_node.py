"""`friction_estimator_node`: answers each loader_state with a friction estimate."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, NoReturn

from ehls_msgs.msg import FrictionEstimate, LoaderState
from ehls_ros.control.friction_estimator import FrictionEstimator
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import check_friction_support
from ehls_ros.control.rig_scale import defaults_for
from ehls_ros.nodes.control import ControlNode
from ehls_ros.nodes.diagnostics import OK, WARN
from ehls_ros.nodes.parameters import declare, values_of
from ehls_ros.nodes.running import run_node
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter
from ehls_ros.physics import sensors
from ehls_ros.schema import text


class Parameters(NamedTuple):
    """Choice of the friction observer."""

    model: Annotated[str, text("friction observer: rig_model, stribeck, ...; empty: the spec's compensation")] = ""


class FrictionEstimatorNode(ControlNode):
    """Node with a friction observer on the measured velocity."""

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__("friction_estimator_node")
        declare(self, Parameters, live=False)
        given = self.spec.compensation
        self.model = self.text_parameter("model") or given.name
        check_friction_support(OBSERVERS, self.model, self.spec.controller_rig, f"{self.get_name()}: model")
        observer = OBSERVERS.load(self.model)
        same = given.name == self.model
        values = given.parameters._asdict() if same else defaults_for(observer.Parameters, self.spec.controller_rig)
        declare(self, observer.Parameters, values, live=False)
        self.observer_parameters = values_of(self, observer.Parameters, self.get_name())
        # Made by `prepare`:
        self.estimator: FrictionEstimator
        self.elements: int
        self.last: int
        self.snapshot: tuple[float, ...]
        self.estimate: list[float]
        self.gaps: int
        self.unmeasured: int
        self.velocity_measured: bool
        self.states: Inbox
        self.estimates: Outbox
        self.waiter: Waiter

    def prepare(self) -> None:
        """Compile the observer and open the topics."""
        period = self.spec.settings.control_period
        self.estimator = FrictionEstimator(self.model, self.spec.controller_rig, period, self.observer_parameters)
        self.elements = elements = self.estimator.element_forces.size
        self.last = -1
        self.snapshot = ()
        self.gaps = 0
        self.unmeasured = 0
        self.velocity_measured = True
        self.states = Inbox(self, LoaderState, "loader_state")
        self.estimates = Outbox(
            self, FrictionEstimate, "friction_estimate", lengths={"element_forces": elements, "slipping": elements}
        )
        self.waiter = Waiter([self.states])

    def release(self) -> None:
        """Close the topics."""
        self.waiter.destroy()
        self.states.destroy()
        self.estimates.destroy()

    def awaited_inputs(self) -> Waiter:
        """Return the waiter for snapshots."""
        return self.waiter

    def react(self) -> bool:
        """Answer every waiting snapshot."""
        before = self.last
        while (message := self.states.take()) is not None:
            stamp, cycle = message[:2]
            if message == self.snapshot:
                # In lockstep the plant repeats its request if the answer has not reached the controller.
                self._answer(stamp)
                continue
            elapsed = cycle - self.last if self.last >= 0 else 1
            if elapsed < 1:
                # The plant has restarted.
                self.estimator.reset()
                elapsed = 1
            elif elapsed > 1:
                self.gaps += 1
            self.last, self.snapshot = cycle, message
            velocity = message[2 + sensors.VELOCITY]
            self.velocity_measured = math.isfinite(velocity)
            self.unmeasured += not self.velocity_measured
            self.estimate = self.estimator.update(velocity, elapsed).tolist()
            self._answer(stamp)
        return self.last != before

    def _answer(self, stamp: int) -> None:
        estimate, n = self.estimate, self.elements
        slipping = [flag != 0.0 for flag in estimate[2 + n :]]
        self.estimates.send(stamp, self.last, estimate[0], estimate[1], n, *estimate[2 : 2 + n], n, *slipping)

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report the running observer and any missed snapshot."""
        figures = {
            "model": self.model,
            "cycle": self.last,
            "gaps": self.gaps,
            "velocity_not_measured": self.unmeasured,
            "malformed": self.states.malformed,
        }
        if not self.velocity_measured:
            return WARN, "no velocity in the snapshots: the last one is held", figures
        return OK, self.activity, figures


def main() -> NoReturn:
    """Run the node."""
    run_node(FrictionEstimatorNode)


if __name__ == "__main__":
    main()
