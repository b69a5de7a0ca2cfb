"""The loop of a node: it runs while the node is active, and checks that the service thread is alive."""

import gc
import sys
import threading
import time
from typing import TYPE_CHECKING

from ehls_ros.hardware.realtime import exact_wake_ups
from ehls_ros.process import Stopping

if TYPE_CHECKING:
    from ehls_ros.nodes.control import ControlNode

WAIT = 0.1
"""Longest time a loop waits before it checks whether to stop [s]."""

LONGEST_TURN = 0.1
"""Largest contribution of one turn of the loop to the time without a heartbeat [s]: a suspended process was not unreachable."""

SWITCH_INTERVAL = 1e-4
"""Time after which a thread yields the interpreter to a waiting one [s]."""


def reduce_wake_up_delays() -> None:
    """Make the calling thread, which runs a loop, wake up and get the interpreter on time."""
    exact_wake_ups()
    # By default the other thread may keep the interpreter for 5 ms.
    sys.setswitchinterval(SWITCH_INTERVAL)


class Loop:
    """The loop of one node.

    The service thread permits and ends it; the thread that runs it calls the other methods.

    Attributes:
        running: whether it runs.
    """

    def __init__(self, node: "ControlNode") -> None:
        """Begin inactive, without a thread that runs the loop."""
        self._node = node
        self._active = threading.Event()
        self._idle = threading.Event()
        self._idle.set()
        # Guards the two events: a thread must not see one before a change and the other after it.
        self._switching = threading.Lock()
        self._is_served = False
        self._has_heartbeat = False
        self._silence = self._turned = 0.0
        self.running = False

    @property
    def is_active(self) -> bool:
        """Whether the loop is to run: the node is active."""
        return self._active.is_set()

    def permit(self) -> None:
        """Let the loop run."""
        with self._switching:
            if self._is_served:
                self._idle.clear()
            self._active.set()

    def withdraw(self) -> None:
        """Let the loop end with the present turn, without waiting for that."""
        self._active.clear()

    def end(self) -> None:
        """Let the loop end, and wait until it has."""
        self._active.clear()
        self._idle.wait()

    def release_waiting(self) -> None:
        """Release a request that waits for the end of the loop: no thread runs it any more."""
        self._idle.set()

    def serve(self) -> None:
        """Note that a thread runs the loop from now on: until then no request has to wait for its end."""
        with self._switching:
            self._is_served = True
            if self._active.is_set():
                self._idle.clear()

    def run(self, stopping: Stopping) -> None:
        """Run the loop whenever the node is active, until an event is set."""
        reduce_wake_up_delays()
        self.serve()
        while not stopping.is_set():
            if not self._active.wait(WAIT):
                # A request to deactivate may wait for the end of a loop that never ran because the node was active too briefly.
                self.settle()
                continue
            # A garbage collection within a cycle would delay the answer; the loops create no reference cycles.
            gc.disable()
            try:
                self.enter()
                while self._active.is_set() and not stopping.is_set():
                    self._node.once()
                    self.supervise()
            except Exception as error:  # noqa: BLE001
                self._node.report_failure(error, "loop")
            finally:
                gc.enable()
                self.leave()

    def enter(self) -> None:
        """Begin the loop."""
        self._idle.clear()
        self._silence, self._turned = 0.0, time.monotonic()
        self.running = True
        self._node.start()

    def leave(self) -> None:
        """End the loop, and announce that to the readers of the node's messages."""
        self.running = False
        node = self._node
        try:
            node.stop()
            node.lifecycle.announce_end()
        except Exception as error:  # noqa: BLE001
            node.report_failure(error, "end of the loop")
        finally:
            if node.links is not None:
                # Once the node is idle, a request may destroy its publishers.
                node.links.publish()
            self._idle.set()

    def settle(self) -> None:
        """Mark the loop as ended if the node was active too briefly for it to run."""
        with self._switching:
            if not self._active.is_set():
                self._idle.set()

    def supervise(self) -> None:
        """Check the heartbeat of the service thread, which handles the emergency stop, and the processor time after a turn."""
        now = time.monotonic()
        self._silence = 0.0 if self._has_heartbeat else self._silence + min(now - self._turned, LONGEST_TURN)
        self._has_heartbeat, self._turned = False, now
        node = self._node
        node.note_service_silence(self._silence)
        processor_demand = node.scheduling.processor_demand
        if processor_demand is not None and processor_demand.look(now):
            node.report_change()

    def note_heartbeat(self) -> None:
        """Note a heartbeat of the service thread."""
        self._has_heartbeat = True
