"""Base of the reference and disturbance nodes, which depend on time alone and run ahead of the cycles at no latency."""

import time
from collections.abc import Mapping
from typing import Any

from ehls_msgs.msg import LoaderState
from ehls_ros.control.references.base import SampledReference
from ehls_ros.experiments.loop import sampled
from ehls_ros.experiments.spec import signal_kind, uses_actuator
from ehls_ros.nodes.codec import NANOSECONDS
from ehls_ros.nodes.control import PATIENCE, ControlNode
from ehls_ros.nodes.diagnostics import OK
from ehls_ros.nodes.transport import Inbox, Outbox, Waiter, message_class, newest_qos
from ehls_ros.recording.topics import ACTUATOR_TOPICS

LEAD = 200
"""Cycles by which a signal of time alone runs ahead; far more than the cycles between two clock messages."""

PAUSE = 0.005
"""Longest polling interval for the newest snapshot in lockstep, in a shared process, or where the lead is only a few
cycles [s]."""

LONG_PAUSE = 0.02
"""Longest polling interval otherwise [s]: each poll wakes up all readers of the published rows."""

SHARE = 0.1
"""Largest fraction of the lead that may pass between two polls."""

ROWS_PER_POLL = 5
"""Cycles between two polls of a loop that shares its process: more rows at once could delay the next cycle."""


class AheadNode(ControlNode):
    """Publishes one row per cycle, ahead of the cycle.

    A row depends on time alone, so the node needs only the approximate cycle, polled from the newest loader_state: a process
    that does not wake in every cycle saves CPU time.
    """

    lead = LEAD
    answers = False
    publishes_actuator = False
    """Whether the node also publishes the actuator's command where a companion of the spec's controller uses it."""

    def __init__(self, name: str) -> None:
        """Declare the common parameters."""
        super().__init__(name)
        self.period_ns = self.spec.settings.control_period * NANOSECONDS
        # Made by `prepare`:
        self.outbox: Outbox
        self.actuator: tuple[Outbox, SampledReference] | None
        self.progress: Inbox
        self.waiter: Waiter
        self.next: int
        self.last: int
        self.epoch_ns: int
        self.moved: float
        self.stalls: int
        self.pause: float
        self.paused_until: float

    def open_outbox(self) -> Outbox:
        """Compile the generator of the rows and return the publisher."""
        raise NotImplementedError

    def row(self, cycle: int) -> list[float]:
        """Return the row of a cycle."""
        raise NotImplementedError

    def prepare(self) -> None:
        """Open the topics."""
        self.outbox = self.open_outbox()
        self.actuator = None
        if self.publishes_actuator and uses_actuator(self.spec):
            disturbance = self.spec.disturbance
            topic = ACTUATOR_TOPICS[signal_kind(disturbance.name)]
            signal = sampled(disturbance.signal, self.spec.settings.control_period)
            self.actuator = Outbox(self, message_class(topic.type), topic.name), signal
        # In lockstep the rig may stand still in a cycle that lacks this node's row, and a second plant may have sent since.
        self.progress = Inbox(self, LoaderState, "loader_state", None if self.lockstep else newest_qos())
        self.waiter = Waiter([self.progress])
        self.next = 0
        self.last = -1
        self.epoch_ns = 0
        self.moved = time.perf_counter()
        self.stalls = 0
        period = self.spec.settings.control_period
        if self.hosted:
            self.pause = min(PAUSE, ROWS_PER_POLL * period)
        else:
            self.pause = PAUSE if self.lockstep else min(LONG_PAUSE, SHARE * self.lead * period)
        self.paused_until = 0.0

    def release(self) -> None:
        """Close the topics."""
        self.waiter.destroy()
        self.progress.destroy()
        self.outbox.destroy()
        if self.actuator is not None:
            self.actuator[0].destroy()

    def start(self) -> None:
        """Publish the rows needed before the first snapshot, or, in lockstep, before the next one."""
        # In realtime the start of the first cycles is unknown: assume that they begin now.
        self.epoch_ns = 0 if self.lockstep else self.now_ns() or 0
        if self.lockstep:
            # Readers may have refused the rows sent before the node was deactivated, and the rig waits for them.
            self.next = max(self.last, 0)
        self._publish_to(self.next + self.lead - 1 if self.lockstep else self.lead - 1)

    def awaited_inputs(self) -> Waiter:
        """Return the waiter for the newest cycle."""
        return self.waiter

    def once(self) -> None:
        """Publish up to ``lead`` cycles beyond the newest one."""
        super().once()
        time.sleep(self.pause)

    def react(self) -> bool:
        """Publish up to ``lead`` cycles beyond the newest one, if it has changed."""
        before = self.next
        if self.hosted and not self.lockstep and self._pauses():
            return False
        while (state := self.progress.take()) is not None:
            stamp, cycle = state[:2]
            if cycle < self.last or cycle > self.next:
                # The plant restarted, or this node started late.
                self.next = cycle
            self._note_progress(cycle)
            self.epoch_ns = stamp - round(cycle * self.period_ns)
            self._publish_to(cycle + self.lead)
        if self._is_repeat_due():
            self.next = max(self.last, 0)
            self._publish_to(self.next + self.lead - 1)
        return self.next != before

    def _pauses(self) -> bool:
        """Return whether the next poll is not due yet, where the loop must not sleep."""
        now = time.perf_counter()
        if now < self.paused_until:
            return True
        self.paused_until = now + self.pause
        return False

    def _note_progress(self, cycle: int) -> None:
        """Note the newest cycle; a snapshot repeated by a rig that waits for an answer is no progress."""
        if cycle != self.last:
            self.last, self.moved, self.stalls = cycle, time.perf_counter(), 0

    def _is_repeat_due(self) -> bool:
        """Return whether to publish the rows ahead again, since the cycles have stalled for :data:`PATIENCE` in lockstep.

        A reader may lack a row because another sender flooded its queue, or because it asks for no stored messages. In the
        first case the interval doubles from one repeat to the next, and begins with the plant's first snapshot.
        """
        if not self.lockstep or time.perf_counter() - self.moved <= PATIENCE:
            return False
        self.moved = time.perf_counter()
        self.stalls += 1
        return (self.last >= 0 and self.stalls.bit_count() == 1) or self.outbox.has_volatile_reader()

    def _publish_to(self, cycle: int) -> None:
        while self.next <= cycle:
            stamp = self.epoch_ns + round(self.next * self.period_ns)
            self.publish_actuator(stamp, self.next)
            self.outbox.send(stamp, self.next, *self.row(self.next))
            self.next += 1

    def publish_actuator(self, stamp_ns: int, cycle: int) -> None:
        """Publish the actuator's command at a cycle if a companion uses it; call it before the reference is sent."""
        if self.actuator is not None:
            outbox, signal = self.actuator
            outbox.send(stamp_ns, cycle, *signal.row(cycle).tolist())

    def health(self) -> tuple[bytes, str, Mapping[str, Any]]:
        """Report how far ahead the node is."""
        figures = {"cycle": self.last, "ahead": self.next - 1 - self.last}
        return OK, self.activity, figures
