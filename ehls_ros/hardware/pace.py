"""Whether a computer keeps up with its cycles: how many a second were due, and how many were answered."""

from typing import Any

WINDOW = 0.5
"""Time over which cycles are counted [s]."""

LEAST = 0.9
"""Part of the cycles that has to be answered; with less, the computer is too slow."""

CLEAR = 0.8
"""Part of the way from there to all of them after which it is not too slow any more."""

CHANGE = 0.1
"""Part of the cycles due by which their number has to change to be told anew."""

ADVICE = (
    "stop other work, permit realtime priority (ehls doctor looks whether it is), choose a longer control_period, or run in "
    "lockstep"
)
"""What to do about a computer that is too slow."""


class Pace:
    """Counts cycles and says when a computer is too slow for them.

    That nothing at all is answered is another thing: then whoever answers is not there.

    Attributes:
        asked: cycles a second that were due in the last window; 0 before the first.
        reached: cycles a second that were answered in it.
        complaint: `too slow: 720 of 1000 cycles/s`; empty while it is not.
    """

    def __init__(self, least: float = LEAST) -> None:
        """Start without a verdict; the first call of :meth:`look` opens the first window.

        Args:
            least: fraction of the cycles that has to be answered.
        """
        self._least = least
        self._start: float | None = None
        self._due = 0.0
        self._answered = 0
        self._told = 0.0
        self.asked = 0.0
        self.reached = 0.0
        self.complaint = ""

    def look(self, now: float, due: float, answered: int) -> bool:
        """Take note of how far the cycles are; once a window is over, judge it.

        Args:
            now: time of a clock that is never set [s].
            due: cycles, counted from anywhere, that should have been answered by now: by the wall's clock where the cycles can
                wait, by the samples that came where they cannot.
            answered: cycles, counted from anywhere, that were answered.

        Returns:
            Whether a window ended with this call; :attr:`complaint` is that of the window then.
        """
        if self._start is None:
            self._open(now, due, answered)
            return False
        elapsed = now - self._start
        if elapsed < WINDOW:
            return False
        self.asked = (due - self._due) / elapsed
        self.reached = (answered - self._answered) / elapsed
        self._open(now, due, answered)
        self._judge()
        return True

    def _open(self, now: float, due: float, answered: int) -> None:
        self._start, self._due, self._answered = now, due, answered

    def _judge(self) -> None:
        least = (self._least + CLEAR * (1.0 - self._least) if self.complaint else self._least) * self.asked
        if not 0.0 < self.reached < least:
            self.complaint = ""
        elif not self.complaint or abs(self.reached - self._told) > CHANGE * self.asked:
            self.complaint, self._told = f"too slow: {self.reached:.0f} of {self.asked:.0f} cycles/s", self.reached

    def figures(self) -> dict[str, Any]:
        """Return figures for diagnostics."""
        return {"cycles_per_second_asked": self.asked, "cycles_per_second_reached": self.reached}
