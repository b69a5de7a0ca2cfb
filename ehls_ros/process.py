"""Process control: stop requests, low priority, end with the parent, and exit after use of the middleware."""

import ctypes
import os
import queue
import signal
import sys
from pathlib import Path
from typing import NoReturn

PR_SET_PDEATHSIG = 1

NICENESS = 10
"""Niceness of a low-priority process; at 19 it would get almost no time on a busy processor."""


class Stopping:
    """Stop request of a process, safe to set in a signal handler.

    With a ``threading.Event``, the handler could interrupt a call of the main thread that holds the event's lock, and would
    then wait for that lock forever.
    """

    def __init__(self) -> None:
        """Start without a stop request."""
        self._told = False
        # Its put is reentrant: the only one in the standard library that is meant for signal handlers.
        self._wake: queue.SimpleQueue[None] = queue.SimpleQueue()

    def set(self) -> None:
        """Request the stop."""
        self._told = True
        self._wake.put(None)

    def is_set(self) -> bool:
        """Return whether a stop was requested."""
        return self._told

    def wait(self, seconds: float) -> bool:
        """Wait for a stop request, at most for a time [s], and return whether there was one; for one thread only."""
        if not self._told:
            try:
                self._wake.get(timeout=seconds)
            except queue.Empty:
                return self._told
        return True


def is_running(number: int) -> bool:
    """Return whether a process of this host is running; a zombie is not.

    Args:
        number: id of the process.
    """
    try:
        state = Path(f"/proc/{number}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def give_way() -> None:
    """Lower the priority of this process; an inherited lower priority is kept."""
    os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))


def end_with(parent: int) -> None:
    """End this process together with its parent, even if the parent is killed.

    Args:
        parent: id of the parent process.
    """
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        # The parent ended before the request took effect.
        os._exit(1)


def end(code: int) -> NoReturn:
    """Flush the output and exit at once, without destructors.

    Fast DDS destroys its static objects after Python has finished, while its own threads still run; about one exit in thirty
    then hangs or crashes. A process that has closed all its resources can skip this.

    Args:
        code: exit code.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
