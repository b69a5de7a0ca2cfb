"""The lifecycle of a node: configuration prepares its resources, activation lets its loop run."""

import contextlib
import threading
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING

from lifecycle_msgs.msg import State
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, ManagedEntity, TransitionCallbackReturn
from std_msgs.msg import String

from ehls_ros.errors import BadInput
from ehls_ros.nodes.transport import Notice
from ehls_ros.recording.topics import LEAVING

if TYPE_CHECKING:
    from ehls_ros.nodes.control import ControlNode

ANNOUNCEMENT_TIME = 0.2
"""Longest wait for the readers to receive the announcement that a node's loop has ended [s]."""

Callback = Callable[["Lifecycle", LifecycleState], TransitionCallbackReturn]


def transition(callback: Callback) -> Callback:
    """End the process when a lifecycle callback raises; rclpy drops the exception.

    Args:
        callback: method of :class:`Lifecycle`.
    """

    @wraps(callback)
    def reported(lifecycle: "Lifecycle", state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return callback(lifecycle, state)
        except Exception as error:  # noqa: BLE001
            lifecycle.node.report_failure(error, callback.__name__.removeprefix("on_"))
            return TransitionCallbackReturn.ERROR

    return reported


class Lifecycle(ManagedEntity):
    """The transitions of one node, of which it is a managed entity.

    Attributes:
        node: the node.
        configured: whether its resources are prepared.
        changing: held during a transition; rclpy's state machine admits one thread at a time, and the main thread brings the
            node up while another serves requests.
    """

    def __init__(self, node: "ControlNode") -> None:
        """Begin unconfigured."""
        self.node = node
        self.configured = False
        self.changing = threading.RLock()
        self._departure: Notice | None = None
        node.add_managed_entity(self)

    def configure(self) -> bool:
        """Configure, unless a lifecycle request has done so; return whether the node is configured."""
        return self._change_from(State.PRIMARY_STATE_UNCONFIGURED, self.node.trigger_configure)

    def activate(self) -> bool:
        """Activate, unless a lifecycle request has changed the state; return whether the node is as requested."""
        return self._change_from(State.PRIMARY_STATE_INACTIVE, self.node.trigger_activate)

    def _change_from(self, state: int, trigger: Callable[[], TransitionCallbackReturn]) -> bool:
        with self.changing:
            return bool(self.node.primary_state != state or trigger() == TransitionCallbackReturn.SUCCESS)

    @transition
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Prepare; a wrong configuration leaves the node unconfigured, with the reason in the log."""
        node = self.node
        self._departure = Notice(node, String, LEAVING.name, 1)
        try:
            node.prepare()
        except (BadInput, OSError) as error:
            node.get_logger().error(str(error))
            self._release_after_failure()
            return TransitionCallbackReturn.FAILURE
        except Exception:
            self._release_after_failure()
            raise
        node.scheduling.claim()
        self.configured = True
        return TransitionCallbackReturn.SUCCESS

    @transition
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the loop run, if the node is ready for that."""
        if not self.node.is_ready():
            return TransitionCallbackReturn.FAILURE
        self.node.refused = ""
        self.node.loop.permit()
        return TransitionCallbackReturn.SUCCESS

    @transition
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the loop to end its turn."""
        self.node.loop.end()
        return TransitionCallbackReturn.SUCCESS

    @transition
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything."""
        self.release()
        return TransitionCallbackReturn.SUCCESS

    @transition
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the loop as deactivation does, and release everything."""
        self.node.loop.end()
        self.release()
        return TransitionCallbackReturn.SUCCESS

    @transition
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to unconfigured: a half-finished transition is not resumed."""
        self.node.loop.end()
        self.release()
        return TransitionCallbackReturn.SUCCESS

    def release(self) -> None:
        """Release the prepared resources, if any."""
        if self.configured:
            self.configured = False
            self.node.release()
            self._close_departure()
            self.node.scheduling.release()

    def _release_after_failure(self) -> None:
        """Release the resources prepared before an exception."""
        # Attributes assigned after the failed step of `prepare` do not exist.
        with contextlib.suppress(AttributeError):
            self.node.release()
        self._close_departure()

    def _close_departure(self) -> None:
        if self._departure is not None:
            self._departure.destroy()
            self._departure = None

    def announce_end(self) -> None:
        """Publish that the node's loop has ended, if its messages are inputs of the control cycle."""
        node, departure = self.node, self._departure
        if node.announces and departure is not None:
            departure.publish(String(data=node.sender), node.sender)
            if not node.hosted:
                # A process that goes on sends the announcement anyway and must not wait.
                departure.publisher.wait_for_all_acked(Duration(seconds=ANNOUNCEMENT_TIME))
