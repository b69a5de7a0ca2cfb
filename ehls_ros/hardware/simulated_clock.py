"""The time of a simulated rig in realtime: the wall's, unless the computer does not keep up with it.

One late answer, and no more, is met as a rig would meet it: the last command is held. From the second in a row on the simulated
time waits for the answers, since a loop of ever longer dead times diverges, and does not catch up afterwards. That ends with a
window in which the cycles kept the wall's pace.
"""

from typing import Any

from ehls_ros.hardware.pace import Pace

BEARABLE = 2
"""Cycles in a row without an answer from which on it is waited for; the law stands no delay of three (docs/measured.md)."""

HOPE = 0.1
"""How long an answer is waited for before whoever answers is taken to be gone [s]."""

SPARE = 0.25
"""How long everybody rests after an answer that was waited for, as part of the time it took."""


class SimulatedClock:
    """Says when a cycle ends. All times are of one clock that is never set [s].

    Attributes:
        waiting: whether the simulated time waits for answers now.
        slipped: how far it has fallen behind the wall's [s].
        missed: cycles that ended without an answer, since there was one.
        late: cycles that ended more than a period after their time.
        pace: whether the computer keeps up.
    """

    def __init__(self, period: float, now: float) -> None:
        """Begin the first cycle.

        Args:
            period: of the cycles [s].
            now: when it begins.
        """
        self._period = period
        self._start = self._began = now
        self._end = now + period
        self._ended = 0
        self._unanswered = 0
        self._overdue = False
        self._rested: float | None = None
        self.waiting = False
        self.slipped = 0.0
        self.missed = 0
        self.late = 0
        self.pace = Pace()

    def remaining(self, now: float, *, answered: bool) -> float:
        """Return how long the cycle goes on, at most, unless its answer comes [s]; 0 where it is to end.

        Args:
            now: the time.
            answered: whether its answer is there.
        """
        if now < self._end:
            return self._end - now
        if self._overdue and answered:
            # Nodes that take turns without a rest would leave the machine nothing.
            if self._rested is None:
                self._rested = now + SPARE * (now - self._began)
            return max(0.0, self._rested - now)
        if answered or not self.waiting or now >= self._end + HOPE:
            return 0.0
        self._overdue = True
        return self._end + HOPE - now

    def end(self, now: float, *, answered: bool, expected: bool) -> bool:
        """End the cycle and begin the next.

        Args:
            now: the time.
            answered: whether its answer is there.
            expected: whether anybody has answered yet.

        Returns:
            Whether what :attr:`pace` has to say has changed.
        """
        if answered:
            self._unanswered = 0
        elif expected:
            self.missed += 1
            self._unanswered += 1
        behind = now - self._end
        self.late += behind > self._period
        long_ago = behind > BEARABLE * self._period
        # Nobody who answers is waited for once it seems to be gone, until it is back.
        self.waiting = answered if self.waiting else self._unanswered == BEARABLE or (answered and long_ago)
        if self._overdue or long_ago:
            self._end = now
            self.slipped += behind
        self._overdue, self._rested = False, None
        self._began = now
        self._end += self._period
        self._ended += 1
        return expected and self._judge(now)

    def _judge(self, now: float) -> bool:
        before = self.pace.complaint
        if self._unanswered > BEARABLE:
            # Who answers is gone, which is no matter of pace.
            self.pace = Pace()
        elif self.pace.look(now, (now - self._start) / self._period, self._ended - self.missed):
            self.waiting = bool(self.pace.complaint)
        return self.pace.complaint != before

    def figures(self) -> dict[str, Any]:
        """Return figures for diagnostics."""
        return {"late": self.late, "slipped_s": self.slipped, **self.pace.figures()}
