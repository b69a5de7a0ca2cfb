"""Execution of a campaign: distribution of missing runs, and storage of their results."""

import itertools
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import yaml

from ehls_ros.experiments.batch import is_ready
from ehls_ros.experiments.campaign.backends import Backend, Chunk, Place
from ehls_ros.experiments.campaign.plan import Plan
from ehls_ros.experiments.campaign.store import Folder, Index, digests_done, write_part
from ehls_ros.experiments.campaign.work import Row, code_version, run_digest, spec_of
from ehls_ros.physics.lane_memory import LANES

CHUNK_CYCLES = 400_000
"""Largest number of control cycles in a chunk: about a second of work."""

MIN_SIDE_BY_SIDE = 6_000_000
"""Number of control cycles from which compilation of a loop for lanes pays off: it takes the time saved by 600 runs of 10 s. A
compiled one is used for fewer."""

MAX_SIDE_BY_SIDE = 1_600_000
"""Largest number of control cycles of runs in lanes, which are in memory together: 0.25 kB each."""

MIN_CHUNKS_LEFT = 3
"""Number of remaining chunks per slot below which chunks shrink, so that all slots end together."""

WRITE_INTERVAL_S = 2.0
"""Longest time before rows are written [s]."""

Progress = Callable[[int, int], None]


class Outcome(NamedTuple):
    """Outcome of one call.

    Attributes:
        runs: total number of runs.
        made: number of runs made by this call; the others existed before.
        wall_s: wall time, including the start of the workers, kernels and table [s].
    """

    runs: int
    made: int
    wall_s: float


def conduct(plan: Plan, folder: Folder, place: Place, progress: Progress | None = None) -> Outcome:
    """Make the missing runs of a campaign and write its table.

    Args:
        plan: the campaign.
        folder: its folder, opened.
        place: backend of the runs.
        progress: called with the number of runs done and the total number.
    """
    start = time.perf_counter()
    folder.campaign.write_text(yaml.safe_dump(plan.file, sort_keys=False, allow_unicode=True), encoding="utf-8")
    work = _Work(plan, folder, progress)
    with place as backend:
        work.do(backend)
    about = {"title": plan.settings.title, "seed": plan.settings.seed, "version": code_version()}
    work.index.write_results(folder, about)
    return Outcome(len(plan), work.made, time.perf_counter() - start)


class _Work:
    """The state of one call of :func:`conduct`.

    Attributes:
        index: the runs so far.
        made: number of rows received.
    """

    def __init__(self, plan: Plan, folder: Folder, progress: Progress | None) -> None:
        self._plan, self._folder, self._progress = plan, folder, progress
        self._done = digests_done(folder)
        self._pending: list[tuple[str, Row]] = []
        self._written_at = time.monotonic()
        self._left = max(len(plan) - len(self._done), 1)
        self._together = LANES if self._pays() else 1
        self._found = 0
        self.index = Index(plan.columns)
        self.made = 0

    def do(self, backend: Backend) -> None:
        """Make all missing runs; an interruption does not lose received rows."""
        if backend.own_kernels and self._left >= LANES and self._pays(compiled=True):
            self._together = LANES
        chunks = self._chunks(backend.slots)
        try:
            first = next(chunks, None)
            if first is None:
                return
            for chunk, rows in backend.work(itertools.chain((first,), chunks)):
                self._take(chunk, rows)
        finally:
            write_part(self._folder, self._pending)

    def _pays(self, *, compiled: bool = False) -> bool:
        """Return whether to make runs in lanes.

        Args:
            compiled: whether to do so for fewer runs too if the loop is already compiled.
        """
        plan = self._plan
        if LANES * plan.cycles > MAX_SIDE_BY_SIDE:
            return False
        if self._left * plan.cycles >= MIN_SIDE_BY_SIDE:
            return True
        return compiled and all(is_ready(spec_of(point.spec)) for point in plan.points)

    def _take(self, chunk: Chunk, rows: list[Row]) -> None:
        self._pending += zip(chunk.digests, rows, strict=True)
        self.made += len(rows)
        if time.monotonic() - self._written_at > WRITE_INTERVAL_S:
            write_part(self._folder, self._pending)
            self._pending, self._written_at = [], time.monotonic()
        if self._progress is not None:
            self._progress(self._found + self.made, len(self._plan))

    def _chunks(self, slots: int) -> Iterator[Chunk]:
        """Index the runs and divide the missing ones into chunks, smaller ones towards the end."""
        most = CHUNK_CYCLES // self._plan.cycles
        digests: list[str] = []
        specs: list[str] = []
        for run in self._plan.runs():
            digest = run_digest(run.spec)
            self.index.add(run, digest)
            if digest in self._done:
                self._found += 1
                continue
            self._done.add(digest)
            digests.append(digest)
            specs.append(run.spec)
            blocks = min(most, self._left // (MIN_CHUNKS_LEFT * slots)) // self._together
            if len(specs) >= max(blocks, 1) * self._together:
                yield Chunk(tuple(digests), tuple(specs), self._together > 1)
                self._left -= len(specs)
                digests, specs = [], []
        if specs:
            yield Chunk(tuple(digests), tuple(specs), self._together > 1)
