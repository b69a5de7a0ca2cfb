"""Realtime loops: absolute deadlines, SCHED_FIFO and locked memory."""

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

from ehls_ros.errors import BadInput

SPIN = 50e-6
"""Busy-wait before a deadline, since a sleeper wakes late [s]."""

MIN_PRIORITY = 1
"""Lowest priority of SCHED_FIFO: ahead of all ordinary work, behind every other realtime thread."""

STACK = 2**20
"""Stack of the middleware's threads; the default is eight times as large [B]."""

DEEP_STACK = 2**22
"""Stack of Python's own threads, in which kernels are compiled [B]."""

LARGE = 2**25
"""Size above which an allocation is mapped separately and returned when freed; glibc's maximum [B]."""

SMALL = 2**18
"""The same for a process that returns freed memory to the system [B]."""

MIN_RESIDENT = 0.25
"""A file with no more than this fraction in memory is hardly used."""

COMPILER = "libllvmlite"
"""Substring of the compiler's file name; once the kernels are compiled, no loop touches it."""

MCL_FUTURE, MCL_ONFAULT = 2, 4
MLOCK_ONFAULT = 1
MADV_DONTNEED = 4
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
PR_SET_TIMERSLACK = 29


class Part(NamedTuple):
    """One mapping of this process's memory: first address, length [B], permissions, file, resident size [KiB]."""

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
        The current time, not before the deadline [s].
    """
    remaining = deadline - time.monotonic() - SPIN
    if remaining > 0.0:
        time.sleep(remaining)
    while (now := time.monotonic()) < deadline:
        pass
    return now


def exact_wake_ups() -> None:
    """Turn off timer slack for this thread, which delays its wake-ups by up to 50 us."""
    ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def threads() -> set[int]:
    """Return the native ids of this process's threads, including those of libraries."""
    return {int(task.name) for task in Path("/proc/self/task").iterdir()}


def prefer(chosen: Iterable[int], priority: int) -> None:
    """Give threads the scheduling class SCHED_FIFO; those that have ended are left out.

    Args:
        chosen: their native ids.
        priority: 1 to 99.

    Raises:
        PermissionError: the system does not permit it.
    """
    for thread in chosen:
        with suppress(ProcessLookupError):
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))


def processors_of(text: str, where: str) -> frozenset[int]:
    """Return the processors that a text names, such as ``1`` or ``0,2-3``; none if it is empty.

    Args:
        text: numbers and ranges, separated by commas.
        where: source of the text, for errors.

    Raises:
        BadInput: it is not such a list, or this process may not use one of the processors.
    """
    allowed = os.sched_getaffinity(0)
    chosen: set[int] = set()
    try:
        for part in filter(None, text.split(",")):
            first, dash, last = part.partition("-")
            chosen |= set(range(int(first), int(last if dash else first) + 1))
    except ValueError:
        chosen = {-1}
    if not chosen <= allowed or (text and not chosen):
        expected = f"some of {','.join(map(str, sorted(allowed)))}, such as {max(allowed)} or {min(allowed)}-{max(allowed)}"
        raise BadInput(f"processors is '{text}'", where, expected)
    return frozenset(chosen)


def keep_to(processors: Collection[int]) -> None:
    """Restrict all threads of this process, and those they start, to these processors."""
    for thread in threads():
        with suppress(ProcessLookupError):
            os.sched_setaffinity(thread, processors)


@contextmanager
def preferring_what_starts(priority: int) -> Iterator[None]:
    """Give SCHED_FIFO to the threads started inside the block, if the system permits it.

    Args:
        priority: 1 to 99.
    """
    before = threads()
    yield
    with suppress(PermissionError):
        prefer(threads() - before, priority)


def limit_reserved_memory() -> None:
    """Limit the memory that this process reserves, and keep freed memory; call it before other threads start.

    By default each thread has a separate allocation arena and a stack of 8 MiB. Freed memory returned to the system would
    have to be requested again in the middle of a cycle.
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
    """Return the mappings of this process's memory."""
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
    """Lock the pages in use and those touched later, except the compiler's.

    Pages that were reserved but never touched take no memory; the compiler's code is dropped.

    Raises:
        OSError: the system does not permit it.
    """
    system = ctypes.CDLL(None, use_errno=True)
    drop_compiler()
    for part in memory():
        area = ctypes.c_void_p(part.start), ctypes.c_size_t(part.length)
        if COMPILER not in part.file and part.permissions.startswith("r") and part.file != "[vsyscall]" and _in_use(part):
            _check(system.mlock2(*area, MLOCK_ONFAULT))
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY or os.geteuid() == 0:
        # Under a limit, allocations beyond it would fail instead of staying unlocked.
        _check(system.mlockall(MCL_FUTURE | MCL_ONFAULT))


def drop_compiler() -> None:
    """Drop the compiler's code, which can be read from its file again at any time; its data may have been modified."""
    for part in memory():
        if COMPILER in part.file and "x" in part.permissions:
            ctypes.CDLL(None).madvise(ctypes.c_void_p(part.start), ctypes.c_size_t(part.length), MADV_DONTNEED)


def release_freed_memory() -> None:
    """Return large freed arrays to the system at once, for processes without deadlines; see :func:`limit_reserved_memory`."""
    system = ctypes.CDLL(None)
    system.mallopt(M_TRIM_THRESHOLD, SMALL)
    system.mallopt(M_MMAP_THRESHOLD, SMALL)


def trim_memory() -> None:
    """Return unused memory to the system, for a process that runs for weeks beside those with deadlines."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    drop_compiler()


def _in_use(part: Part) -> bool:
    """Return whether a mapping is worth locking: anonymous memory in use, or a file of which more than a little is resident."""
    least = MIN_RESIDENT * part.length if part.file.startswith("/") else 0
    return 1024 * part.resident > least


def _check(result: int) -> None:
    """Raise OSError if a system call failed."""
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def drop_priority() -> Mapping[int, int]:
    """Move all threads of this process from SCHED_FIFO to ordinary scheduling.

    Returns:
        The priorities of the threads that had SCHED_FIFO, by native id.
    """
    had = {}
    for thread in threads():
        with suppress(ProcessLookupError):
            if os.sched_getscheduler(thread) == os.SCHED_FIFO:
                had[thread] = os.sched_getparam(thread).sched_priority
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
    return had


def restore_priority(had: Mapping[int, int]) -> None:
    """Request SCHED_FIFO again.

    Args:
        had: the result of :func:`drop_priority`.
    """
    for thread, priority in had.items():
        with suppress(PermissionError):
            prefer([thread], priority)


def claim(priority: int, behind: Collection[int] = ()) -> tuple[str, ...]:
    """Prepare this process for a loop with deadlines; takes some tenths of a second.

    Existing objects are frozen and garbage collection is turned off, so the loop must not create reference cycles. As far as
    the system permits, the memory in use is locked and all existing threads, including the middleware's, get SCHED_FIFO.

    Args:
        priority: for SCHED_FIFO, 1 to 99; 0 leaves scheduling and memory unchanged.
        behind: threads, by native id, that get :data:`MIN_PRIORITY` instead.

    Returns:
        A sentence for each request that was not permitted.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    if priority == 0:
        return ()
    refused = []
    try:
        prefer(threads().difference(behind), priority)
        prefer(behind, MIN_PRIORITY)
    except PermissionError:
        refused.append(f"SCHED_FIFO at priority {priority} is not permitted (RLIMIT_RTPRIO)")
    try:
        lock_memory()
    except OSError as error:
        refused.append(f"memory cannot be locked ({error.strerror}; RLIMIT_MEMLOCK)")
    return tuple(refused)
