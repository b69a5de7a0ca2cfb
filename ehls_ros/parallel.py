"""Independent tasks on all processors, with progress."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

Task = Callable[[], Any]
"""A function at the top level of a module or a partial of one, which can be sent to another process."""

Progress = Callable[[int, int], None]


def run_tasks(tasks: Sequence[Task], workers: int | None = None, progress: Progress | None = None) -> list[Any]:
    """Run tasks in separate processes.

    Args:
        tasks: the tasks; with the longest first, all processors stay busy to the end.
        workers: number of processes; None: one per processor. With 1 the tasks run in this process.
        progress: called with the number of tasks done and the total number.

    Returns:
        The results in the order of the tasks.
    """
    count = min(workers or len(os.sched_getaffinity(0)), len(tasks))
    results: list[Any] = [None] * len(tasks)
    if count <= 1:
        for index, task in enumerate(tasks):
            results[index] = task()
            if progress is not None:
                progress(index + 1, len(tasks))
        return results
    # A forked process could inherit a lock held by the thread that draws the progress.
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        numbers = {pool.submit(task): index for index, task in enumerate(tasks)}
        try:
            for done, future in enumerate(as_completed(numbers), start=1):
                results[numbers[future]] = future.result()
                if progress is not None:
                    progress(done, len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results
