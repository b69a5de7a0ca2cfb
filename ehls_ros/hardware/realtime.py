"""A loop on its own clock: absolute deadlines, and what the system lets a process claim for it."""

import ctypes
import gc
import os
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SPIN = 50e-6
"""Time before a deadline that is spent looking at the clock, since a sleeper wakes late [s]."""

LOWEST = 1
"""Lowest priority of SCHED_FIFO: before all ordinary work, behind whoever asked for more."""

MCL_CURRENT, MCL_FUTURE = 1, 2
PR_SET_TIMERSLACK = 29


def sleep_until(deadline: float) -> float:
    """Wait for a time of ``time.monotonic``.

    Args:
        deadline: the time [s].

    Returns:
        The time now, not before the deadline [s].
    """
    remaining = deadline - time.monotonic() - SPIN
    if remaining > 0.0:
        time.sleep(remaining)
    while (now := time.monotonic()) < deadline:
        pass
    return now


def exact_wake_ups() -> None:
    """Let this thread's waits end when they should, not up to 50 us later together with others."""
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def threads() -> set[int]:
    """Return the native ids of this process's threads, those of libraries too."""
    return {int(task.name) for task in Path("/proc/self/task").iterdir()}


def prefer(chosen: Iterable[int], priority: int) -> None:
    """Give threads the scheduling class SCHED_FIFO.

    Args:
        chosen: their native ids.
        priority: 1 to 99.

    Raises:
        PermissionError: the system does not permit it.
    """
    for thread in chosen:
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))


@contextmanager
def preferring_what_starts(priority: int) -> Iterator[None]:
    """Give SCHED_FIFO to the threads that are started meanwhile, if the system permits it.

    Args:
        priority: 1 to 99.
    """
    before = threads()
    yield
    with suppress(PermissionError):
        prefer(threads() - before, priority)


def claim(priority: int, behind: Collection[int] = ()) -> tuple[str, ...]:
    """Get this process ready for a loop with deadlines; takes some tenths of a second.

    The objects there are leave garbage collection, which is then off: the loop must not make cycles. Memory is locked,
    and all threads there are, those of the middleware too, get the scheduling class SCHED_FIFO, as far as the system
    permits.

    Args:
        priority: for SCHED_FIFO, 1 to 99; 0 leaves scheduling and memory as they are.
        behind: threads, by their native ids, that get :data:`LOWEST` instead.

    Returns:
        What was not permitted, a sentence each.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    if priority == 0:
        return ()
    refused = []
    try:
        prefer(threads().difference(behind), priority)
        prefer(behind, LOWEST)
    except PermissionError:
        refused.append(f"SCHED_FIFO at priority {priority} is not permitted (RLIMIT_RTPRIO)")
    if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        refused.append(f"memory cannot be locked ({os.strerror(ctypes.get_errno())}; RLIMIT_MEMLOCK)")
    return tuple(refused)
