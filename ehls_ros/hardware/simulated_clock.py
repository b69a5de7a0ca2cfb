"""Time of a simulated rig in realtime: wall time, unless the computer cannot keep up.

After one late answer the last command is held, as on a rig. From the second late answer in a row simulated time waits for the
answers and does not catch up, because a loop with growing dead time diverges. Waiting ends with a window in which the cycles
kept up with wall time. A run also starts in this state: a computer that is too slow would miss the first answers, when the
commands change most from cycle to cycle.

Where the controller shares the plant's process, a cycle that begins late is answered as soon as any other. Dead time does not
grow, and simulated time catches up.
"""

from ehls_ros.hardware.pace import Pace

MAX_UNANSWERED = 2
"""Unanswered cycles in a row after which simulated time waits; a delay of three makes the law unstable (docs/measured.md)."""

MAX_WAIT = 2.0
"""Longest wait for an answer, after which the controller counts as absent [s]. A busy computer may well stop it for half a
second, and a loop that continues without it diverges within a few cycles."""

CATCH_UP = 0.01
"""Delay of the cycles that is still caught up where it delays no answer [s]."""

IDLE_RATIO = 0.25
"""Idle time after an awaited answer, as a fraction of the time it took."""


class SimulatedClock:
    """Decides when a cycle ends. All times are monotonic [s].

    Attributes:
        waiting: whether simulated time is waiting for answers.
        slipped: lag of simulated time behind wall time [s].
        missed: unanswered cycles since the first answer.
        late: cycles that ended more than a period late.
        pace: whether the computer keeps up.
    """

    def __init__(self, period: float, now: float) -> None:
        """Begin the first cycle.

        Args:
            period: of the cycles [s].
            now: start of the cycle.
        """
        self._period = period
        self._start = self._began = now
        self._end = now + period
        self._ended = 0
        self._unanswered = 0
        self._overdue = False
        self._idle_until: float | None = None
        self.waiting = True
        self.slipped = 0.0
        self.missed = 0
        self.late = 0
        self.pace = Pace()

    def remaining(self, now: float, *, answered: bool, present: bool = True) -> float:
        """Return the longest time the cycle may still last if no answer comes [s]; 0: end it now.

        Args:
            now: current time.
            answered: whether the cycle has been answered.
            present: whether there is a controller to wait for.
        """
        if now < self._end:
            return self._end - now
        if self._overdue and answered:
            # Without a pause the nodes would take turns and leave the machine no idle time.
            if self._idle_until is None:
                self._idle_until = now + IDLE_RATIO * (now - self._began)
            return max(0.0, self._idle_until - now)
        if answered or not (self.waiting and present) or now >= self._end + MAX_WAIT:
            return 0.0
        self._overdue = True
        return self._end + MAX_WAIT - now

    def end(self, now: float, *, answered: bool, expected: bool, prompt: bool = False) -> bool:
        """End the cycle and begin the next.

        Args:
            now: current time.
            answered: whether the cycle has been answered.
            expected: whether any cycle has been answered yet.
            prompt: whether a cycle that begins late is answered no later after its begin.

        Returns:
            Whether the complaint of :attr:`pace` has changed.
        """
        if answered:
            self._unanswered = 0
        elif expected:
            self.missed += 1
            self._unanswered += 1
        behind = now - self._end
        self.late += behind > self._period
        much_later = behind > max(MAX_UNANSWERED * self._period, CATCH_UP if prompt else 0.0)
        # A controller that seems absent is not awaited until it answers again.
        self.waiting = answered if self.waiting else self._unanswered == MAX_UNANSWERED or (answered and much_later)
        if self._overdue or much_later:
            self._end = now
            self.slipped += behind
        self._overdue, self._idle_until = False, None
        self._began = now
        self._end += self._period
        self._ended += 1
        return expected and self._update_pace(now)

    def _update_pace(self, now: float) -> bool:
        before = self.pace.complaint
        if self._unanswered > MAX_UNANSWERED:
            # A missing controller gives no information on the computer's speed.
            self.pace = Pace()
        elif self.pace.look(now, (now - self._start) / self._period, self._ended - self.missed):
            self.waiting = bool(self.pace.complaint)
        return self.pace.complaint != before

    def figures(self) -> dict[str, float]:
        """Return figures for diagnostics."""
        return {"late": self.late, "slipped_s": self.slipped, **self.pace.figures()}
