"""Check of a computer's speed: cycles answered per second against cycles due."""

WINDOW = 0.5
"""Time over which cycles are counted [s]."""

MIN_ANSWERED = 0.9
"""Fraction of the cycles that must be answered; below it the computer is too slow."""

CLEAR = 0.8
"""Hysteresis: fraction of the gap between the limit and all cycles above which the complaint is cleared."""

CHANGE = 0.1
"""Minimum change of the answered rate for an update of the complaint, as a fraction of the cycles due."""

ADVICE = (
    "stop other work, permit realtime priority (check it with ehls doctor), choose a longer control_period, or run in lockstep"
)
"""Advice for a computer that is too slow."""


class Pace:
    """Counter of cycles, with a complaint while the computer is too slow for them.

    A window without any answer does not count as slow: the controller is missing.

    Attributes:
        asked: cycles per second due in the last window; 0 before the first.
        reached: cycles per second answered in it.
        complaint: `too slow: 720 of 1000 cycles/s`; empty while the computer keeps up.
    """

    def __init__(self, least: float = MIN_ANSWERED) -> None:
        """Start without a complaint; the first call of :meth:`look` opens the first window.

        Args:
            least: fraction of the cycles that must be answered.
        """
        self._least = least
        self._window: tuple[float, float, int] | None = None
        self._reported = 0.0
        self.asked = 0.0
        self.reached = 0.0
        self.complaint = ""

    def look(self, now: float, due: float, answered: int) -> bool:
        """Record the progress; evaluate the window once it is over.

        Args:
            now: monotonic time [s].
            due: cycles due so far, from any origin. They are counted by the wall clock if cycles can wait, otherwise by the
                samples received.
            answered: cycles answered so far, from any origin.

        Returns:
            Whether this call ended a window and updated :attr:`complaint`.
        """
        if self._window is None:
            self._window = now, due, answered
            return False
        begin, due_before, answered_before = self._window
        elapsed = now - begin
        if elapsed < WINDOW:
            return False
        self._window = now, due, answered
        self.asked = (due - due_before) / elapsed
        self.reached = (answered - answered_before) / elapsed
        least = (self._least + CLEAR * (1.0 - self._least) if self.complaint else self._least) * self.asked
        if not 0.0 < self.reached < least:
            self.complaint = ""
        elif not self.complaint or abs(self.reached - self._reported) > CHANGE * self.asked:
            self.complaint, self._reported = f"too slow: {self.reached:.0f} of {self.asked:.0f} cycles/s", self.reached
        return True

    def figures(self) -> dict[str, float]:
        """Return figures for diagnostics."""
        return {"cycles_per_second_asked": self.asked, "cycles_per_second_reached": self.reached}
