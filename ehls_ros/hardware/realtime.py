"""A loop on its own clock: absolute deadlines, and what the system lets a process claim for it."""

import ctypes
import gc
import os
import resource
import threading
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

SPIN = 50e-6
"""Time before a deadline that is spent looking at the clock, since a sleeper wakes late [s]."""

LOWEST = 1
"""Lowest priority of SCHED_FIFO: before all ordinary work, behind whoever asked for more."""

STACK = 2**20
"""Stack of the middleware's threads, of which each would reserve eight times that [B]."""

DEEP_STACK = 2**22
"""Stack of Python's own threads, in which kernels are compiled [B]."""

LARGE = 2**25
"""Size from which on a piece of memory is asked from the system by itself and given back; the largest glibc allows [B]."""

HARDLY = 0.25
"""A file of which no more than this part is in memory is hardly used."""

COMPILER = "libllvmlite"
"""Part of the file name of what only compiles; once the kernels are there, no loop touches it."""

MCL_FUTURE, MCL_ONFAULT = 2, 4
MLOCK_ONFAULT = 1
MADV_DONTNEED = 4
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
PR_SET_TIMERSLACK = 29


class Part(NamedTuple):
    """A part of this process's memory: first address, length [B], permissions, file, and how much of it is there [KiB]."""

    start: int
    length: int
    permissions: str
    file: str
    resident: int


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


def be_frugal() -> None:
    """Let this process reserve little memory and keep what it has; to be called before other threads start.

    Each thread would else have an arena of its own to allocate from and a stack of 8 MiB, and memory given back to the system
    would have to be asked for anew in the middle of a cycle.
    """
    system = ctypes.CDLL(None)
    system.mallopt(M_ARENA_MAX, 1)
    system.mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
    system.mallopt(M_MMAP_THRESHOLD, LARGE)
    attributes = ctypes.create_string_buffer(64)
    system.pthread_attr_init(attributes)
    system.pthread_attr_setstacksize(attributes, ctypes.c_size_t(STACK))
    system.pthread_setattr_default_np(attributes)
    threading.stack_size(DEEP_STACK)


def memory() -> list[Part]:
    """Return the parts of this process's memory."""
    parts: list[Part] = []
    for line in Path("/proc/self/smaps").read_text(encoding="utf-8").splitlines():
        key, *words = line.split(maxsplit=5)
        if key == "Rss:":
            parts[-1] = parts[-1]._replace(resident=int(words[0]))
        elif not key.endswith(":"):
            start, end = (int(address, 16) for address in key.split("-"))
            parts.append(Part(start, end - start, words[0], words[4] if len(words) > 4 else "", 0))
    return parts


def lock_memory() -> None:
    """Keep in memory what is there and what will be touched, page by page, but not the compiler.

    What was reserved and never touched takes no memory, and what lies in the compiler's file is given back.

    Raises:
        OSError: the system does not permit it.
    """
    system = ctypes.CDLL(None, use_errno=True)
    for part in memory():
        area = ctypes.c_void_p(part.start), ctypes.c_size_t(part.length)
        if COMPILER in part.file:
            # Code can be read from its file again at any time; data may have been written to.
            if "x" in part.permissions:
                system.madvise(*area, MADV_DONTNEED)
        elif part.permissions.startswith("r") and part.file != "[vsyscall]" and _in_use(part):
            _done(system.mlock2(*area, MLOCK_ONFAULT))
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY or os.geteuid() == 0:
        # With a limit, memory beyond it would be refused instead of not being locked.
        _done(system.mlockall(MCL_FUTURE | MCL_ONFAULT))


def _in_use(part: Part) -> bool:
    """Tell whether a part of the memory is worth locking: what is no file's, and a file that is read more than a bit."""
    least = HARDLY * part.length if part.file.startswith("/") else 0
    return 1024 * part.resident > least


def _done(result: int) -> None:
    """Turn the result of a system call into an exception where it failed."""
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def step_back() -> Mapping[int, int]:
    """Give SCHED_FIFO back, for all threads of this process.

    Returns:
        The priorities of the threads that had it, by their native ids.
    """
    had = {}
    for thread in threads():
        with suppress(ProcessLookupError):
            if os.sched_getscheduler(thread) == os.SCHED_FIFO:
                had[thread] = os.sched_getparam(thread).sched_priority
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
    return had


def step_forward(had: Mapping[int, int]) -> None:
    """Ask for SCHED_FIFO again.

    Args:
        had: what :func:`step_back` returned.
    """
    for thread, priority in had.items():
        with suppress(ProcessLookupError, PermissionError):
            prefer([thread], priority)


def claim(priority: int, behind: Collection[int] = ()) -> tuple[str, ...]:
    """Get this process ready for a loop with deadlines; takes some tenths of a second.

    The objects there are leave garbage collection, which is then off: the loop must not make cycles. The memory in use is
    locked, and all threads there are, those of the middleware too, get the scheduling class SCHED_FIFO, as far as the system
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
    try:
        lock_memory()
    except OSError as error:
        refused.append(f"memory cannot be locked ({error.strerror}; RLIMIT_MEMLOCK)")
    return tuple(refused)
