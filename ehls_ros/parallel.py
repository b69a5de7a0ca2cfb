"""Independent tasks on all processors, with progress."""

import itertools
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, as_completed, wait
from functools import partial
from multiprocessing import forkserver, get_context
from multiprocessing.context import BaseContext
from types import ModuleType, TracebackType
from typing import Any, Self

Task = partial[Any]
"""A call of a module's function, which can be sent to another process."""

Progress = Callable[[int, int], None]

READY = "ehls_ros.ready"
"""Module that makes a process ready to load kernels."""

AHEAD = 2
"""Tasks of a stream handed out per process."""


def prepare(*modules: str) -> BaseContext:
    """Begin to import what processes will need, in a process of its own that they are forked from; return their context.

    A process forked from this one could inherit a lock held by the thread that draws the progress. The fork server has no
    threads, and imports the modules once for all processes; one that runs already stays as it is.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([*modules, READY])
    forkserver.ensure_running()
    return context


class Workers:
    """Processes that run tasks; they start with the first tasks and end with the ``with`` block."""

    def __init__(self, count: int | None = None) -> None:
        """Set the number of processes; None: one per processor. With 1, the tasks run in this process."""
        self._count = count or len(os.sched_getaffinity(0))
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        """Start nothing yet."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End the processes; after an error, without waiting for tasks."""
        if self._pool is not None:
            self._pool.shutdown(wait=error is None, cancel_futures=True)

    def run(self, tasks: Sequence[Task], progress: Progress | None = None) -> list[Any]:
        """Run tasks.

        Args:
            tasks: the tasks; with the longest first, all processors stay busy to the end.
            progress: called with the number of tasks done and the total number.

        Returns:
            The results in the order of the tasks.
        """
        results: list[Any] = [None] * len(tasks)
        if self._count == 1:
            for index, task in enumerate(tasks):
                results[index] = task()
                if progress is not None:
                    progress(index + 1, len(tasks))
            return results
        modules = sorted({task.func.__module__ for task in tasks})
        numbers = {self._submit(task, modules): index for index, task in enumerate(tasks)}
        for done, future in enumerate(as_completed(numbers), start=1):
            results[numbers[future]] = future.result()
            if progress is not None:
                progress(done, len(tasks))
        return results

    def stream(self, tasks: Iterable[Task]) -> Iterator[Any]:
        """Run tasks, which are taken as they are needed, a few ahead of the work.

        Yields:
            Their results, in the order in which they are done.
        """
        if self._count == 1:
            yield from (task() for task in tasks)
            return
        waiting = iter(tasks)
        under_way: set[Future[Any]] = set()
        while True:
            for task in itertools.islice(waiting, AHEAD * self._count - len(under_way)):
                under_way.add(self._submit(task, [task.func.__module__]))
            if not under_way:
                return
            done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)

    def _submit(self, task: Task, modules: list[str]) -> Future[Any]:
        """Have a task run by processes that have imported some modules."""
        if self._pool is None:
            context = prepare(*modules)
            # Ctrl-C ends a process even inside compiled code, where Python would notice it only afterwards.
            self._pool = ProcessPoolExecutor(self._count, context, signal.signal, (signal.SIGINT, signal.SIG_DFL))
        # A process runs the script anew that its parent runs, unless there is none; one without a guard would begin again.
        script, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
        try:
            return self._pool.submit(task)
        finally:
            sys.modules["__main__"] = script


def run_tasks(tasks: Sequence[Task], workers: int | None = None, progress: Progress | None = None) -> list[Any]:
    """Run tasks in new processes, see :meth:`Workers.run`.

    Args:
        tasks: the tasks.
        workers: number of processes; None: one per processor.
        progress: called with the number of tasks done and the total number.
    """
    with Workers(min(workers or len(os.sched_getaffinity(0)), max(1, len(tasks)))) as pool:
        return pool.run(tasks, progress)
