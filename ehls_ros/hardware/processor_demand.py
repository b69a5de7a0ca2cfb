"""Limit on a realtime loop's demand for processor time, above which it gives up SCHED_FIFO for a while.

Demand is the running time of the loop plus its time in the run queue. This catches several loops that block one another as
well as one that occupies a processor alone. A loop that hardly runs disturbs no other, however long it queues.
"""

import os
from collections.abc import Mapping
from pathlib import Path

from ehls_ros.hardware.realtime import drop_priority, restore_priority

WINDOW = 0.3
"""Time over which the demand is averaged [s]."""

MIN_RUNNING = 0.1
"""Fraction of a processor below which a loop disturbs no other."""

PAUSE = 10.0
"""Time after which SCHED_FIFO is requested again [s]."""


class ProcessorDemand:
    """Measures a loop's demand for processor time from inside the loop.

    Attributes:
        demand: demand over the last window, as a fraction of a processor.
        given_back: number of times SCHED_FIFO was given up.
        complaint: reason for giving up SCHED_FIFO; empty while it is not given up.
    """

    def __init__(self, share: float, statistics: Path) -> None:
        """Open the statistics.

        Args:
            share: largest demand, as a fraction of a processor; 1: no limit.
            statistics: the thread's schedstat file: running time and queueing time.

        Raises:
            OSError: the file cannot be opened.
        """
        self._share = share
        self._statistics = os.open(statistics, os.O_RDONLY)
        self._start: tuple[float, float, float] | None = None
        self._had: Mapping[int, int] = {}
        self._until = 0.0
        self.demand = 0.0
        self.given_back = 0
        self.complaint = ""

    def look(self, now: float) -> bool:
        """Evaluate the demand once a window is over; give up SCHED_FIFO or request it again.

        Args:
            now: monotonic time [s].

        Returns:
            Whether :attr:`complaint` has changed.
        """
        if self._start is None:
            self._start = now, *self._so_far()
            return False
        elapsed = now - self._start[0]
        if elapsed < WINDOW:
            return False
        ran, waited = self._so_far()
        had = (ran - self._start[1]) / elapsed
        self.demand = had + (waited - self._start[2]) / elapsed
        self._start = now, ran, waited
        if self.complaint and now >= self._until:
            restore_priority(self._had)
            self._had, self.complaint = {}, ""
            return True
        if self.complaint or self._share >= 1.0 or self.demand <= self._share or had <= MIN_RUNNING:
            return False
        self._had = drop_priority()
        self._until = now + PAUSE
        self.given_back += 1
        self.complaint = (
            f"the loop needs {100 * self.demand:.0f} % of a processor, processor_share is {100 * self._share:.0f} %: "
            f"SCHED_FIFO is given back for {PAUSE:.0f} s; run fewer nodes here, or choose a longer control_period"
        )
        return True

    def _so_far(self) -> tuple[float, float]:
        """Return the running time of the loop's thread and its queueing time for a processor [s]."""
        ran, waited = os.pread(self._statistics, 100, 0).split()[:2]
        return 1e-9 * int(ran), 1e-9 * int(waited)

    def figures(self) -> dict[str, float]:
        """Return figures for diagnostics."""
        return {"processor_wanted": self.demand, "priority_given_back": self.given_back}

    def close(self) -> None:
        """Close the statistics."""
        os.close(self._statistics)


def statistics_of(thread: int) -> Path:
    """Return the schedstat file of a thread of this process, by its native id."""
    return Path(f"/proc/self/task/{thread}/schedstat")
