"""The healthy rig as the monitor has learnt it: departures to be tested, scatter of its blocks, and range of its signals."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.coverage import Range, covered, ranges
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.monitoring.blocks import Scores, scores
from ehls_ros.diagnosis.monitoring.change_test import BlockStatistics, block_statistics, with_scatter
from ehls_ros.diagnosis.monitoring.directions import Direction, directions, remainders
from ehls_ros.diagnosis.monitoring.tracking import WANTED, IdentifiedRig, Reading, readings, tracked
from ehls_ros.diagnosis.stages import CHANNELS
from ehls_ros.experiments.monitoring.saved_state import LearntRig
from ehls_ros.samples import Mask
from ehls_ros.trajectory import Trajectory

RIG_FILE, OWN_RECORDING, RECORDINGS = "the rig file", "the first minutes", "healthy recordings"
"""Kinds of baseline."""

RELEARNT_BLOCKS = 24
"""Number of blocks without a change after which their scatter is learnt as well."""

MAX_RELEARNT_BLOCKS = 720
"""Maximum number of such blocks from which the scatter is learnt."""


class Baseline:
    """The healthy rig.

    Attributes:
        kind: kind of baseline.
        recordings: recordings of the healthy rig by name, if they are the baseline.
        directions: the tested departures.
        sections: scores of the healthy blocks, one section per condition of the rig.
    """

    def __init__(self, recordings: Mapping[str, Trajectory]) -> None:
        """Start without knowledge of the rig.

        Args:
            recordings: recordings of the healthy rig by name; none: the rig file is the baseline.
        """
        self.kind = RECORDINGS if recordings else RIG_FILE
        self.recordings = dict(recordings)
        self.directions: tuple[Direction, ...] = ()
        self.sections = list[list[Scores]]()
        self._numbers: dict[str, int] = {}
        self._remainder: Array = np.zeros(0)
        self._seen: dict[str, Range] = {}
        self._unchanged = list[Scores]()

    @property
    def powers(self) -> Mask:
        """Whether a quantity is the power of a channel's residual rather than a departure, shape (n,)."""
        return np.arange(len(self.directions) + len(CHANNELS)) >= len(self.directions)

    def use(self, kind: str, recordings: Mapping[str, Trajectory] | None = None) -> None:
        """Replace the kind of baseline, and the recordings of the healthy rig."""
        self.kind, self.recordings = kind, dict(recordings or {})

    def choose_directions(self, evidence: Evidence) -> None:
        """Choose the departures that are observable in a recording of the healthy rig."""
        self.directions = directions(evidence, WANTED)
        self._numbers = tracked(self.directions)

    def learn_residuals(self, recordings: Iterable[Evidence | None]) -> None:
        """Learn the remaining residuals of the model and the ranges of the signals from recordings of the healthy rig."""
        compared = [evidence for evidence in recordings if evidence is not None]
        left = [remainders(evidence, self.directions) for evidence in compared]
        self._remainder = np.max(left, axis=0) if left else np.zeros(len(self.directions))
        self._seen = ranges(compared)

    def learn_unchanged(self, found: Scores) -> bool:
        """Add a block without a change; return whether the statistics of the healthy rig have to be updated."""
        if len(self._unchanged) >= MAX_RELEARNT_BLOCKS:
            return False
        self._unchanged.append(Scores(*found[:3]))
        return len(self._unchanged) % RELEARNT_BLOCKS == 0

    def learn_condition(self, rows: Array) -> None:
        """Add a further condition of the healthy rig.

        Args:
            rows: score, information and share of its blocks, shape (3, blocks, n).
        """
        self.sections.append([Scores(score, information, share) for score, information, share in zip(*rows, strict=True)])

    def forget_unchanged(self) -> None:
        """Discard the blocks without a change, as they refer to another model."""
        self._unchanged.clear()

    def forget(self) -> None:
        """Discard all blocks, as the healthy rig is learnt again."""
        self.sections = []
        self._unchanged.clear()

    def restore(self, learnt: LearntRig) -> None:
        """Restore the healthy rig that another monitor has learnt, except for its residuals."""
        self.kind = learnt.kind
        if [direction.key for direction in self.directions] != [direction.key for direction in learnt.directions]:
            self.directions, self._remainder = learnt.directions, np.zeros(len(learnt.directions))
        self._numbers = tracked(self.directions)
        self.sections = [list(section) for section in learnt.sections]
        if learnt.recording is not None:
            self.recordings = {OWN_RECORDING: learnt.recording}

    def learnt(self) -> LearntRig:
        """Return the healthy rig as learnt."""
        sections = tuple(map(tuple, self.sections))
        return LearntRig(self.kind, self.directions, sections, self.recordings.get(OWN_RECORDING))

    def statistics(self) -> BlockStatistics:
        """Return the statistics of the healthy blocks.

        Departures from a valid rig file are measured from the file itself. A departure that seems present in the healthy rig
        already is not tested: a delay, for example, averages noise and slightly improves the fit even if there is none.
        """
        found = _statistics(self.sections)
        if len(self._unchanged) >= RELEARNT_BLOCKS:
            found = with_scatter(found, _statistics([*self.sections, self._unchanged]))
        # A noise floor is never exact, and a residual below the noise is not a fault.
        power = self.powers
        found = found._replace(level=np.where(power, np.maximum(found.level, 0.0) + rules.POWER_TOLERATED, found.level))
        if self.kind != RIG_FILE:
            # The remaining residual grows with the motion, so its power is not informative.
            unknown = power & (found.level > 2.0 * rules.POWER_TOLERATED)
            remainder = np.concatenate([self._remainder, np.zeros(len(CHANNELS))])
            return found._replace(certainty=np.where(unknown, 0.0, found.certainty), remainder=remainder)
        direction = ~power
        biased = np.abs(found.level) * np.sqrt(found.certainty) > rules.BIASED * found.scatter * np.sqrt(found.dependence)
        return found._replace(
            level=np.where(direction, 0.0, found.level),
            certainty=np.where(direction, np.where(biased, 0.0, np.inf), found.certainty),
        )

    def is_outside(self, evidence: Evidence) -> bool:
        """Return whether a block lies outside the range of the healthy recordings; the rig file's model is valid everywhere."""
        return self.kind != RIG_FILE and any(item.beyond > rules.MENTIONED_UNSEEN for item in covered(self._seen, evidence))

    def scores(self, evidence: Evidence) -> list[Scores]:
        """Return the score of each block, of blocks that follow their lead."""
        begins = rules.MONITOR_LEAD + rules.BLOCK * np.arange(rules.MONITOR_AT_ONCE)
        return scores(evidence, self.directions, tuple(self._numbers.values()), begins.tolist())

    def tracked_scores(self, evidence: Evidence) -> list[Scores]:
        """Return the score of each block in the directions of the coefficients alone."""
        begins = rules.MONITOR_LEAD + rules.BLOCK * np.arange(rules.MONITOR_AT_ONCE)
        own = [self.directions[number] for number in self._numbers.values()]
        return scores(evidence, own, range(len(own)), begins.tolist())

    def readings(self, rig: IdentifiedRig, blocks: Sequence[Scores], statistics: BlockStatistics) -> tuple[Reading, ...]:
        """Fit the coefficients to blocks; none if no departure represents a coefficient.

        Args:
            rig: the model to which the blocks refer, as identified.
            blocks: the blocks.
            statistics: statistics of the healthy rig.
        """
        if not self._numbers:
            return ()
        rows = np.array(list(self._numbers.values()), dtype=np.intp)
        return readings(self.directions, self._numbers, rig, blocks, statistics.scatter[rows])

    def quantity(self, number: int) -> str:
        """Return the name of a tested quantity."""
        if number < len(self.directions):
            return self.directions[number].name
        return f"the residual of the channel {list(CHANNELS)[number - len(self.directions)]}"


def _statistics(sections: Sequence[Sequence[Scores]]) -> BlockStatistics:
    blocks = [block for section in sections for block in section]
    section = np.repeat(np.arange(len(sections)), [len(s) for s in sections])
    return block_statistics(np.array([b.score for b in blocks]), np.array([b.information for b in blocks]), section)
