"""Independent tasks on all processors, with progress."""

import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from types import TracebackType
from typing import Any, Self

Task = partial[Any]
"""A call of a module's function, which can be sent to another process."""

Progress = Callable[[int, int], None]


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
        if self._pool is None:
            # A process forked from this one could inherit a lock held by the thread that draws the progress. The fork
            # server has no threads, and imports the tasks' modules once for all processes.
            context = get_context("forkserver")
            context.set_forkserver_preload(sorted({task.func.__module__ for task in tasks}))
            # Ctrl-C ends a process even inside compiled code, where Python would notice it only afterwards.
            self._pool = ProcessPoolExecutor(self._count, context, signal.signal, (signal.SIGINT, signal.SIG_DFL))
        numbers = {self._pool.submit(task): index for index, task in enumerate(tasks)}
        for done, future in enumerate(as_completed(numbers), start=1):
            results[numbers[future]] = future.result()
            if progress is not None:
                progress(done, len(tasks))
        return results


def run_tasks(tasks: Sequence[Task], workers: int | None = None, progress: Progress | None = None) -> list[Any]:
    """Run tasks in new processes, see :meth:`Workers.run`.

    Args:
        tasks: the tasks.
        workers: number of processes; None: one per processor.
        progress: called with the number of tasks done and the total number.
    """
    with Workers(min(workers or len(os.sched_getaffinity(0)), max(1, len(tasks)))) as pool:
        return pool.run(tasks, progress)
