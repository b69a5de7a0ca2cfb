"""Modes of the monitor and the transitions between them, without samples."""

import numpy as np
import pytest

from ehls_ros.diagnosis.monitoring.blocks import Scores
from ehls_ros.diagnosis.monitoring.change_test import BlockStatistics, Change, ChangeTest
from ehls_ros.experiments.monitoring.health import State
from ehls_ros.experiments.monitoring.modes import (
    EXAMINATION_INTERVAL,
    Comparing,
    Examining,
    Idle,
    Learning,
    ScoredBlocks,
    Suspecting,
    Suspicion,
    Watching,
    cleared,
    judged,
    unjudged,
)

CHANGE = Change(0, 1.2, 4, 5, 3, 1.0, 0.1)
FIRST = Suspicion(CHANGE, 100.0, 4, 100.0)


@pytest.fixture
def blocks() -> ScoredBlocks:
    one = np.ones(1)
    healthy = BlockStatistics(0.0 * one, np.inf * one, one, 0.0 * one, one, 1e4, 0.0 * one, one, 0.0 * one)
    return ScoredBlocks(ChangeTest(healthy, 1000.0), averaged=2)


def scores(size: float) -> Scores:
    return Scores(np.full(1, size * 100.0), np.full(1, 100.0), np.full(1, 1.0))


def test_enough_blocks_whose_samples_are_available_are_compared_with_the_rig_file():
    mode: Learning | Comparing = Learning()
    for begin in (0.0, 5.0, 20.0):
        assert isinstance(mode, Learning)
        mode = mode.add(begin, oldest=begin - 16.0, count=3)
    assert mode == Learning((5.0, 20.0))
    assert mode.add(25.0, oldest=0.0, count=3) == Comparing((5.0, 20.0, 25.0))


def test_a_detected_change_is_examined_and_then_suspected(blocks):
    watching = Watching(blocks)
    assert watching.tested(None, 100.0) is watching
    examining = watching.tested(CHANGE, 100.0)
    assert examining == Examining(blocks, CHANGE, FIRST)
    assert examining.examined() == Suspecting(blocks, FIRST)


@pytest.mark.parametrize(
    ("found", "now", "expected"),
    [
        (None, 110.0, Watching),
        (CHANGE._replace(blocks=5), 110.0, Suspecting),
        (CHANGE._replace(blocks=6), 110.0, Examining),
        (CHANGE._replace(blocks=5), 100.0 + EXAMINATION_INTERVAL, Examining),
    ],
    ids=["not detected any more", "few more samples", "half as many samples again", "a minute later"],
)
def test_a_suspected_change_is_examined_again_with_more_samples(blocks, found, now, expected):
    mode = Suspecting(blocks, FIRST).tested(found, now)
    assert type(mode) is expected
    if isinstance(mode, Examining):
        assert mode.change is found
        assert mode.suspicion == FIRST._replace(blocks=found.blocks, examined=now)


def test_judging_continues_as_before_and_a_diagnosis_is_not_interrupted(blocks):
    for mode in (Watching(blocks), Suspecting(blocks, FIRST)):
        idle = unjudged(mode)
        assert idle == Idle(mode)
        assert unjudged(idle) is idle
        assert judged(idle) is mode
    examining = Examining(blocks, CHANGE, FIRST)
    assert unjudged(examining) is examining
    assert judged(examining) is examining


def test_cleared_blocks_leave_no_suspicion(blocks):
    blocks.add(0.0, scores(0.0))
    assert cleared(Suspecting(blocks, FIRST)) == Watching(blocks)
    assert cleared(Examining(blocks, CHANGE, FIRST)) == Watching(blocks)
    assert cleared(Idle(Suspecting(blocks, FIRST))) == Idle(Watching(blocks))
    assert (blocks.test.blocks, len(blocks.begins), len(blocks.recent)) == (0, 0, 0)


def test_restored_blocks_are_discarded_if_they_show_a_change(blocks):
    def rows(size: float) -> np.ndarray:
        block = scores(size)
        return np.repeat(np.array([block.score, block.information, block.share])[:, None], 6, axis=1)

    begins = tuple(2.5 * number for number in range(6))
    blocks.restore(begins, rows(0.0))
    assert tuple(blocks.begins) == begins
    assert blocks.test.blocks == 6
    blocks.clear()
    blocks.restore(begins, rows(5.0))
    assert blocks.test.blocks == 0
    assert not blocks.begins


def test_each_mode_has_a_published_state(blocks):
    modes = (Learning(), Comparing((0.0,)), Watching(blocks), Suspecting(blocks, FIRST), Examining(blocks, CHANGE, FIRST))
    states = (State.LEARNING, State.LEARNING, State.WATCHING, State.WATCHING, State.EXAMINING)
    assert tuple(mode.state for mode in modes) == states
    assert Idle(Watching(blocks)).state == State.IDLE
