"""Thread pool for the parallel evaluation of hypotheses."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import TypeVar

import numpy as np

from ehls_ros.diagnosis.evidence import Evidence, gather
from ehls_ros.diagnosis.fit import Worker
from ehls_ros.diagnosis.loss import loss

SCREENED_BLOCKS = 8
"""Blocks of the recording in which the starting values are compared."""

Item = TypeVar("Item")
Done = TypeVar("Done")

Progress = Callable[[str, float], None]
"""Called with the current activity and the completed fraction of the diagnosis."""


class Pool:
    """Threads with one worker each; the kernels release Python's global lock.

    Attributes:
        evidence: the recording compared with the given model.
        few: a few blocks of it if it is long enough for a selection to save time, otherwise all of it.
    """

    def __init__(self, evidence: Evidence, threads: int, few: Evidence | None = None) -> None:
        """Start the threads.

        Args:
            evidence: the recording compared with the given model.
            threads: number of threads.
            few: blocks of another pool, to be used here too.
        """
        self.evidence, self.few = evidence, few or few_blocks(evidence)
        self._threads = threads
        subset = None if self.few.record is evidence.record else self.few
        self._free: SimpleQueue[Worker] = SimpleQueue()
        for _ in range(threads):
            self._free.put(Worker(evidence, subset))
        self._executor, self._leaders = ThreadPoolExecutor(threads), ThreadPoolExecutor(threads)

    def beside(self, evidence: Evidence, few: Evidence | None = None) -> "Pool":
        """Return a pool of the same size for the same recording with another noise floor or model, and a few blocks of it."""
        return Pool(evidence, self._threads, few or self.few)

    def map(self, work: Callable[[Worker, Item], Done], items: Sequence[Item]) -> list[Done]:
        """Apply a function to every item in parallel and return the results in order; the first exception is raised."""

        def one(item: Item) -> Done:
            worker = self._free.get()
            try:
                return work(worker, item)
            finally:
                self._free.put(worker)

        return list(self._executor.map(one, items))

    def lead(self, work: Callable[[Item], Done], items: Sequence[Item]) -> list[Done]:
        """Apply a function that itself calls :meth:`map` to every item in parallel; results in the items' order."""
        return list(self._leaders.map(work, items))

    def close(self) -> None:
        """Stop the threads."""
        self._leaders.shutdown()
        self._executor.shutdown()


def few_blocks(evidence: Evidence) -> Evidence:
    """Return the evidence from a few blocks of a recording, or all of it if a selection would save no time."""
    ranges = informative_blocks(evidence)
    if ranges is None:
        return evidence
    few = gather(evidence.record.parts(ranges), evidence.rig, evidence.setup, seed=0)
    return evidence.standard.judged(few)


def informative_blocks(evidence: Evidence) -> list[tuple[int, int]] | None:
    """Return the sample ranges of the blocks with the largest loss, and of as many spread over the recording.

    None if the recording is too short for a selection to save time.
    """
    samples, blocks, count = len(evidence.record.time), evidence.blocks, SCREENED_BLOCKS
    if blocks <= 3 * count // 2:
        return None
    worst = np.zeros(blocks)
    for c in evidence.channels:
        total = np.bincount(evidence.block[c], weights=loss(evidence.base.values[c]), minlength=blocks)
        worst = np.maximum(worst, total / max(float(total.mean()), 1e-300))
    chosen = {int(b) for b in np.linspace(0, blocks - 1, count // 2).round()}
    for b in np.argsort(-worst):
        if len(chosen) >= count:
            break
        chosen.add(int(b))
    return [(-(-b * samples // blocks), -(-(b + 1) * samples // blocks)) for b in sorted(chosen)]
