"""Realtime that does not starve the machine: whoever keeps ordinary work from a processor gives SCHED_FIFO back for a while.

A canary, a process of ordinary priority that does nothing but read what it is sent, waits where the loop runs. What it has
not read after :data:`LIMIT`, nobody else of ordinary priority could have done there either. It is a process and no thread,
for a thread that is kept from running while it holds the interpreter would keep the loop waiting in its turn.
"""

import ctypes
import fcntl
import os
import subprocess
import termios
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Protocol

from ehls_ros.hardware.realtime import step_back, step_forward

LOOK = 0.1
"""How often the loop looks after the canary [s]."""

LIMIT = 0.3
"""Time for which a loop may keep ordinary work from a processor [s]."""

REST = 10.0
"""Time after which SCHED_FIFO is asked for again [s]."""

READER = "/bin/cat"
"""What reads all that comes and ends with whoever sends."""


class Canary(Protocol):
    """What has to be able to run."""

    def waits(self) -> bool:
        """Tell whether it has not yet been able to run where it was sent."""

    def send(self, processor: int) -> None:
        """Ask it to run on a processor."""

    def close(self) -> None:
        """Let it go."""


class Reader:
    """A canary that is a process."""

    def __init__(self) -> None:
        """Start it, with a session of its own, so that Ctrl-C does not reach it."""
        read, self._pipe = os.pipe()
        try:
            self._process = subprocess.Popen([READER], stdin=read, stdout=subprocess.DEVNULL, start_new_session=True)
        finally:
            os.close(read)
        os.sched_setscheduler(self._process.pid, os.SCHED_OTHER, os.sched_param(0))

    def waits(self) -> bool:
        """Tell whether there is something it has not read."""
        unread = fcntl.ioctl(self._pipe, termios.FIONREAD, bytes(4))
        return any(unread)

    def send(self, processor: int) -> None:
        """Move it to a processor and give it something to read, unless there still is something."""
        # It may have been killed; a processor may be forbidden.
        with suppress(OSError):
            os.sched_setaffinity(self._process.pid, {processor})
            if not self.waits():
                os.write(self._pipe, b"\n")

    def close(self) -> None:
        """End it."""
        os.close(self._pipe)
        self._process.kill()
        self._process.wait()


class Courtesy:
    """Looks, from inside a loop with SCHED_FIFO, whether ordinary work still gets its turn.

    Attributes:
        given_back: how often SCHED_FIFO was given back.
        complaint: what there is to say now; empty while the process has what it asked for.
    """

    def __init__(self, canary: Canary, now: float) -> None:
        """Begin.

        Args:
            canary: what has to be able to run; it is closed with this.
            now: time of a clock that is never set [s].
        """
        self._canary = canary
        self._processor = -1
        self._sent = self._next = now
        self._had: Mapping[int, int] = {}
        self._until = 0.0
        self.given_back = 0
        self.complaint = ""

    def look(self, now: float) -> bool:
        """Look, if it is time; give SCHED_FIFO back or take it again.

        Args:
            now: as above [s].

        Returns:
            Whether :attr:`complaint` is another than before.
        """
        if now < self._next:
            return False
        self._next = now + LOOK
        if self.complaint:
            return self._resume(now)
        here = processor()
        waits = self._canary.waits()
        if waits and here == self._processor:
            return now - self._sent >= LIMIT and self._yield(now)
        if not waits or now - self._sent >= LIMIT:
            # Where the loop is not any more, another one is in the way, and looks for itself.
            self._canary.send(here)
            self._processor, self._sent = here, now
        return False

    def _yield(self, now: float) -> bool:
        self._had = step_back()
        self._until = now + REST
        self.given_back += 1
        waited = f"{1e3 * (now - self._sent):.0f} ms"
        self.complaint = (
            f"ordinary work got no time on processor {self._processor} for {waited}: SCHED_FIFO is given back "
            f"for {REST:.0f} s; run fewer nodes here, or ask for fewer cycles a second"
        )
        return True

    def _resume(self, now: float) -> bool:
        if now < self._until:
            return False
        step_forward(self._had)
        self._had, self.complaint = {}, ""
        self._processor = -1
        return True

    def figures(self) -> dict[str, Any]:
        """Return figures for diagnostics."""
        return {"priority_given_back": self.given_back}

    def close(self) -> None:
        """Let the canary go."""
        self._canary.close()


def processor() -> int:
    """Return the processor this thread runs on."""
    return int(ctypes.CDLL(None).sched_getcpu())
