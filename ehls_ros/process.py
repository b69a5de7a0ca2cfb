"""Processes: what tells them to stop, those behind all others, and how those end that used the middleware or lost a parent."""

import ctypes
import os
import queue
import signal
import sys
from pathlib import Path
from typing import NoReturn

PR_SET_PDEATHSIG = 1

NICENESS = 10
"""Niceness of a process that gives way. At 19 a busy processor would leave it next to nothing."""


class Stopping:
    """Whether a process was told to stop.

    A signal handler may set it whatever the handler interrupts. In a ``threading.Event`` it may interrupt the main thread's own
    call, which holds the event's lock: then the handler waits for that lock forever.
    """

    def __init__(self) -> None:
        """Begin without having been told."""
        self._told = False
        # Its put is the one in the library that is made for signal handlers.
        self._wake: queue.SimpleQueue[None] = queue.SimpleQueue()

    def set(self) -> None:
        """Tell to stop."""
        self._told = True
        self._wake.put(None)

    def is_set(self) -> bool:
        """Return whether the process was told."""
        return self._told

    def wait(self, seconds: float) -> bool:
        """Wait until told, at most for a time [s], and return whether it was; for one thread."""
        if not self._told:
            try:
                self._wake.get(timeout=seconds)
            except queue.Empty:
                return self._told
        return True


def is_running(number: int) -> bool:
    """Return whether a process of this host runs; one that has ended and waits for its parent does not.

    Args:
        number: id of the process.
    """
    try:
        state = Path(f"/proc/{number}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def give_way() -> None:
    """Let this process give way to others; one whose parent does so already is not put further behind."""
    os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))


def end_with(parent: int) -> None:
    """Let this process end when the one that started it does, even if that is killed.

    Args:
        parent: id of the process that started it.
    """
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        # It ended before this was asked for.
        os._exit(1)


def end(code: int) -> NoReturn:
    """Flush the output and exit at once, without destructors.

    Fast DDS destroys its static objects after Python has finished, while its own threads still run; about one exit in
    thirty then hangs or crashes. A process that has closed everything it opened can skip that.

    Args:
        code: exit code.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
