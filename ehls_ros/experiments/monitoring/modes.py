"""Modes of the monitor, and the transitions between them.

=============  =====================================================================================
Learning       collects blocks of the healthy rig; once complete → Comparing
Comparing      a diagnosis compares them with the rig file; judged → Watching, otherwise → Learning
Watching       no change detected; detected → Examining, samples cannot be judged → Idle
Suspecting     a detected change has no cause yet; not detected any more → Watching, more samples → Examining
Examining      a diagnosis examines a change; it has a cause → Watching, it has none yet → Suspecting
Idle           samples cannot be judged; they can again → Watching or Suspecting, as before
=============  =====================================================================================

From any mode, a repair or an unexplained change leads to Learning.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.change_test import Change, ChangeTest
from ehls_ros.experiments.monitoring.health import State

EXAMINATION_GROWTH = 1.5
"""Factor by which the samples since an onset must have grown before they are diagnosed again."""

EXAMINATION_INTERVAL = 60.0
"""Time after which they are diagnosed again in any case [s]: a drift is larger in the latest samples."""


class ScoredBlocks:
    """Blocks scored against the present model, and their test for a change.

    Attributes:
        test: the test.
        begins: begin times of its blocks [s].
        recent: the last of these blocks, over which coefficients are averaged.
    """

    def __init__(self, test: ChangeTest, averaged: int) -> None:
        """Start without blocks.

        Args:
            test: a test without blocks.
            averaged: number of blocks over which coefficients are averaged.
        """
        self.test = test
        self.begins = deque[float](maxlen=rules.LONGEST_WATCH)
        self.recent = deque[Scores](maxlen=averaged)

    def add(self, begin: float, found: Scores) -> None:
        """Add a block that begins at a time [s]."""
        self.begins.append(begin)
        self.test.add(found.score, found.information, found.share)
        self.recent.append(found)

    def restore(self, begins: Sequence[float], rows: Array) -> None:
        """Restore blocks that another monitor has tested, unless they show a change: the samples for its diagnosis are lost.

        Args:
            begins: their begin times, shape (blocks,) [s].
            rows: their score, information and share, shape (3, blocks, n).
        """
        self.begins.extend(begins)
        for row in rows.swapaxes(0, 1):
            self.test.add(*row)
        if self.test.change() is not None:
            self.clear()

    def clear(self) -> None:
        """Discard all blocks, as they refer to another model."""
        self.test.restart()
        self.begins.clear()
        self.recent.clear()


class Suspicion(NamedTuple):
    """A detected change without a confirmed cause.

    Attributes:
        first: the change when it was first detected.
        noticed: time of that [s].
        blocks: number of blocks since its onset at the last diagnosis.
        examined: time of that diagnosis [s].
    """

    first: Change
    noticed: float
    blocks: int
    examined: float


@dataclass(frozen=True)
class Learning:
    """Collecting blocks of the healthy rig.

    Attributes:
        begins: begin times of the blocks collected [s].
    """

    begins: tuple[float, ...] = ()
    state: ClassVar[State] = State.LEARNING

    def add(self, begin: float, oldest: float, count: int) -> "Learning | Comparing":
        """Add a block.

        Args:
            begin: its begin time [s].
            oldest: begin time of the oldest block whose samples are still available [s].
            count: number of blocks needed.
        """
        begins = (*(each for each in self.begins if each >= oldest), begin)
        return Comparing(begins) if len(begins) >= count else Learning(begins)


@dataclass(frozen=True)
class Comparing:
    """A diagnosis compares the healthy rig with its file.

    Attributes:
        begins: begin times of the blocks compared [s].
    """

    begins: tuple[float, ...]
    state: ClassVar[State] = State.LEARNING


@dataclass(frozen=True)
class Watching:
    """Testing blocks, without a detected change."""

    blocks: ScoredBlocks
    state: ClassVar[State] = State.WATCHING

    def tested(self, change: Change | None, now: float) -> "Watching | Examining":
        """Return the mode after a test at a time [s]."""
        return self if change is None else Examining(self.blocks, change, Suspicion(change, now, change.blocks, now))


@dataclass(frozen=True)
class Suspecting:
    """Testing blocks, with a detected change that has no cause yet."""

    blocks: ScoredBlocks
    suspicion: Suspicion
    state: ClassVar[State] = State.WATCHING

    def tested(self, change: Change | None, now: float) -> "Watching | Suspecting | Examining":
        """Return the mode after a test at a time [s]."""
        if change is None:
            return Watching(self.blocks)
        last = self.suspicion
        if change.blocks < EXAMINATION_GROWTH * last.blocks and now - last.examined < EXAMINATION_INTERVAL:
            return self
        return Examining(self.blocks, change, last._replace(blocks=change.blocks, examined=now))


@dataclass(frozen=True)
class Examining:
    """A diagnosis examines a change."""

    blocks: ScoredBlocks
    change: Change
    suspicion: Suspicion
    state: ClassVar[State] = State.EXAMINING

    def examined(self) -> Suspecting:
        """Return the mode after the diagnosis, until its result is accepted."""
        return Suspecting(self.blocks, self.suspicion)


@dataclass(frozen=True)
class Idle:
    """Samples cannot be judged.

    Attributes:
        before: the mode with which judging continues.
    """

    before: Watching | Suspecting
    state: ClassVar[State] = State.IDLE

    @property
    def blocks(self) -> ScoredBlocks:
        """The blocks tested before."""
        return self.before.blocks


Testing = Watching | Suspecting | Examining | Idle
"""Modes in which the healthy rig is known."""

Mode = Learning | Comparing | Testing


def judged(mode: Testing) -> Watching | Suspecting | Examining:
    """Return the mode after samples that can be judged."""
    return mode.before if isinstance(mode, Idle) else mode


def unjudged(mode: Testing) -> Examining | Idle:
    """Return the mode after samples that cannot be judged; a diagnosis under way continues."""
    return Idle(mode) if isinstance(mode, Watching | Suspecting) else mode


def cleared(mode: Testing) -> Watching | Idle:
    """Return the mode after all blocks are discarded; a diagnosis under way no longer refers to any."""
    mode.blocks.clear()
    return Idle(Watching(mode.blocks)) if isinstance(mode, Idle) else Watching(mode.blocks)
