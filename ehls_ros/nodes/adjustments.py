"""Adjustments of a running law: its live parameters, and a rig that an operator has accepted."""

from typing import Any

from std_msgs.msg import String

from ehls_ros.control.adaptation.reach import sizes
from ehls_ros.control.controller import Controller
from ehls_ros.control.controllers.base import ControllerLaw, Model, model_of
from ehls_ros.control.estimate_bounds import bounds_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.accepted_rig import accepted_model
from ehls_ros.nodes.control import ControlNode
from ehls_ros.recording.topics import ACCEPTED_RIG


class Adjustments:
    """Requested adjustments of a law, which take effect between two cycles.

    The requests arrive in the service thread; the loop calls :meth:`apply`.

    Attributes:
        tuning: the tuning that the node starts with.
        bounds: of the estimates of the law, by the tuning in force.
        tuned_at: cycle of the last change of the tuning; -1 before the first.
        acceptance: whether the last accepted rig is in use; empty before the first.
    """

    def __init__(self, node: ControlNode, law: ControllerLaw, tuning: Any) -> None:
        """Begin without requests.

        Args:
            node: owner.
            law: the law's module.
            tuning: its parameters.
        """
        self._node = node
        self._law = law
        self._requested: Any = None
        self._model: Model | None = None
        self.tuning = tuning
        self.bounds = bounds_of(law, tuning)
        self.tuned_at = -1
        self.acceptance = ""

    def retune(self, tuning: Any) -> None:
        """Request another tuning."""
        self._requested = tuning

    def accept(self, message: String) -> None:
        """Request the use of a rig that an operator has accepted; refuse an invalid one or one from several publishers."""
        node = self._node
        publishers = node.get_publishers_info_by_topic(ACCEPTED_RIG.name)
        if len(publishers) > 1:
            names = ", ".join(sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in publishers))
            self._refuse(f"{names} publish {ACCEPTED_RIG.name}; stop all but one, and accept again")
            return
        rig, period = node.spec.controller_rig, node.spec.settings.control_period
        try:
            self._model = accepted_model(message.data, rig, period, ACCEPTED_RIG.name)
        except BadInput as error:
            self._refuse(str(error))

    def _refuse(self, reason: str) -> None:
        self.acceptance = f"refused: {reason}"
        self._node.get_logger().error(f"the accepted rig is not used: {reason}")

    def apply(self, controller: Controller, cycle: int) -> None:
        """Apply the requests before a cycle."""
        if self._requested is not None:
            controller.retune(self._requested)
            self.bounds = bounds_of(self._law, self._requested)
            self._requested = None
            self.tuned_at = cycle
        if self._model is not None:
            self._change_rig(controller, self._model, cycle)
            self._model = None

    def _change_rig(self, controller: Controller, model: Model, cycle: int) -> None:
        """Begin the transition to an accepted rig, or refuse it if it differs too much from the rig file's."""
        rig = self._node.spec.controller_rig
        try:
            duration = controller.accept(model, sizes(model_of(rig, model.period), rig.limits))
        except BadInput as error:
            self._refuse(str(error))
        else:
            self.acceptance = f"in use from cycle {cycle} on"
            self._node.get_logger().info(
                f"the accepted rig is in use from control cycle {cycle} on; the transition takes {duration:.1f} s"
            )
