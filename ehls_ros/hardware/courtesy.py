"""Realtime that does not starve the machine: a loop that wants a processor all the time gives SCHED_FIFO back for a while.

What counts is what the loop wants, not what it gets: time it ran and time it stood in the queue behind others of its kind. So
several loops that are each kept from running by the others are found out as one that has a processor to itself. Who hardly runs
at all is in nobody's way, however long it waits behind the rest.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ehls_ros.hardware.realtime import step_back, step_forward

WINDOW = 0.3
"""Time for which a loop may want a processor all the time [s]."""

LEAST = 0.1
"""Part of a processor that a loop has to have had to be in anybody's way."""

REST = 10.0
"""Time after which SCHED_FIFO is asked for again [s]."""


class Courtesy:
    """Looks, from inside a loop with SCHED_FIFO, what part of a processor the loop wants.

    Attributes:
        wanted: part of a processor the loop wanted over the last window.
        given_back: how often SCHED_FIFO was given back.
        complaint: what there is to say now; empty while the process has what it asked for.
    """

    def __init__(self, share: float, statistics: Path) -> None:
        """Begin.

        Args:
            share: part of a processor the loop may want; with 1 there is no limit.
            statistics: the file where the system says how long the loop's thread ran and how long it waited for a processor.

        Raises:
            OSError: the system does not tell.
        """
        self._share = share
        self._statistics = os.open(statistics, os.O_RDONLY)
        self._start: tuple[float, float, float] | None = None
        self._had: Mapping[int, int] = {}
        self._until = 0.0
        self.wanted = 0.0
        self.given_back = 0
        self.complaint = ""

    def look(self, now: float) -> bool:
        """Look, once a window is over; give SCHED_FIFO back or take it again.

        Args:
            now: time of a clock that is never set [s].

        Returns:
            Whether :attr:`complaint` is another than before.
        """
        if self._start is None:
            self._start = now, *self._so_far()
            return False
        elapsed = now - self._start[0]
        if elapsed < WINDOW:
            return False
        ran, waited = self._so_far()
        had = (ran - self._start[1]) / elapsed
        self.wanted = had + (waited - self._start[2]) / elapsed
        self._start = now, ran, waited
        if self.complaint:
            return now >= self._until and self._resume()
        return self._share < 1.0 and self.wanted > self._share and had > LEAST and self._yield(now)

    def _so_far(self) -> tuple[float, float]:
        """Return how long the loop's thread ran and how long it waited for a processor [s]."""
        ran, waited = os.pread(self._statistics, 100, 0).split()[:2]
        return 1e-9 * int(ran), 1e-9 * int(waited)

    def _yield(self, now: float) -> bool:
        self._had = step_back()
        self._until = now + REST
        self.given_back += 1
        self.complaint = (
            f"the loop wants {100 * self.wanted:.0f} % of a processor, processor_share is {100 * self._share:.0f} %: "
            f"SCHED_FIFO is given back for {REST:.0f} s; run fewer nodes here, or choose a longer control_period"
        )
        return True

    def _resume(self) -> bool:
        step_forward(self._had)
        self._had, self.complaint = {}, ""
        return True

    def figures(self) -> dict[str, Any]:
        """Return figures for diagnostics."""
        return {"processor_wanted": self.wanted, "priority_given_back": self.given_back}

    def close(self) -> None:
        """Look no more."""
        os.close(self._statistics)


def statistics_of(thread: int) -> Path:
    """Return the file that tells about a thread of this process, by its native id."""
    return Path(f"/proc/self/task/{thread}/schedstat")
