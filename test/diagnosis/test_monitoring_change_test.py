"""The monitor's test: its error rate, its sensitivity, and the insufficiency of a single block."""

import numpy as np
import pytest

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.monitoring.change_test import HOUR, BlockStatistics, ChangeTest, block_statistics

QUANTITIES = 12
INFORMATION = 100.0


def healthy(scatter=1.0, certainty=np.inf, spread=0.0, variation=np.inf, remainder=0.0):
    rows = np.full((4, QUANTITIES), 0.0)
    rows[1:] = np.array([certainty, scatter, spread])[:, None]
    many = np.full(QUANTITIES, 1e4)
    one = np.ones(QUANTITIES)
    return BlockStatistics(*rows, one, 1e4, variation * one, many, remainder * one)


def feed(test, score, information=INFORMATION):
    """Add a block each of whose departures changes the balance by a hundredth."""
    test.add(score, np.full(QUANTITIES, information), np.full(QUANTITIES, 0.01))


def noise(rng, size=0.0):
    return INFORMATION * size + np.sqrt(INFORMATION) * rng.standard_normal(QUANTITIES)


def test_false_alarms_are_rarer_than_the_rate_that_was_set():
    """Thirty are allowed in this time; sums over overlapping times are correlated, so there are fewer, but some."""
    rng, hours = np.random.default_rng(1), 0.1
    test = ChangeTest(healthy(), hours)
    alarms = 0
    for _ in range(round(30 * hours * HOUR / rules.BLOCK)):
        feed(test, noise(rng))
        if test.change() is not None:
            alarms += 1
            test.restart()
    assert 1 <= alarms <= 30


def test_a_jump_is_found_with_its_onset_and_its_size():
    rng, size = np.random.default_rng(2), 0.25
    test = ChangeTest(healthy(), 1000.0)
    for _ in range(60):
        feed(test, noise(rng))
        assert test.change() is None
    step = np.zeros(QUANTITIES)
    step[3] = size
    for blocks in range(1, 30):  # noqa: B007
        feed(test, noise(rng, step))
        found = test.change()
        if found is not None:
            break
    assert found.quantity == 3
    assert found.latest <= found.blocks <= found.earliest
    assert found.latest <= blocks <= found.earliest
    assert found.size == pytest.approx(size, abs=3.0 * found.deviation)


def test_a_drift_too_slow_for_any_minute_is_found():
    rng = np.random.default_rng(3)
    test = ChangeTest(healthy(), 1000.0)
    for block in range(1200):
        drift = np.zeros(QUANTITIES)
        drift[5] = 0.1 * block / 1200
        feed(test, noise(rng, drift))
        found = test.change()
        if found is not None:
            break
    assert found is not None
    assert found.quantity == 5
    assert found.blocks > 60


def test_one_block_alone_is_an_incident_however_far_it_is_off():
    rng = np.random.default_rng(4)
    test = ChangeTest(healthy(), 1000.0)
    for block in range(200):
        feed(test, noise(rng, 1e3 if block % 40 == 0 else 0.0))
        assert test.change() is None


def test_a_departure_within_the_healthy_spread_or_too_small_to_matter_is_none():
    rng = np.random.default_rng(5)
    spread = ChangeTest(healthy(spread=0.1), 1000.0)
    small = ChangeTest(healthy(), 1000.0)
    for _ in range(600):
        score = noise(rng, 0.2)
        feed(spread, score)
        small.add(score, np.full(QUANTITIES, INFORMATION), np.full(QUANTITIES, 0.5 * rules.RELEVANT / 0.3))
        assert spread.change() is None
        assert small.change() is None


def test_a_departure_no_larger_than_what_the_model_leaves_of_a_healthy_rig_is_none():
    """A departure of 0.5 changes the balance by half a hundredth."""
    rng = np.random.default_rng(9)
    rough, exact = ChangeTest(healthy(remainder=0.02), 1000.0), ChangeTest(healthy(), 1000.0)
    found = []
    for _ in range(100):
        score = noise(rng, 0.5)
        for test in (rough, exact):
            feed(test, score)
        assert rough.change() is None
        found.append(exact.change())
    assert any(found)


def test_a_departure_beyond_the_healthy_variation_is_found_below_the_remainder():
    """Blocks so certain that a departure is many scatters in each; of the healthy rig, sizes vary by 0.05."""
    rng = np.random.default_rng(12)
    known, concealed = (ChangeTest(healthy(variation=v, remainder=0.02), 1000.0) for v in (0.05, np.inf))
    for size, expected in ((0.2, False), (0.8, True)):
        known.restart()
        concealed.restart()
        for _ in range(20):
            score = 100.0 * (INFORMATION * size + np.sqrt(INFORMATION) / 10.0 * rng.standard_normal(QUANTITIES))
            for test in (known, concealed):
                feed(test, score, 100.0 * INFORMATION)
        assert (known.change() is not None) is expected
        assert concealed.change() is None


def test_the_variation_is_that_between_blocks_beyond_their_noise():
    rng, variation = np.random.default_rng(13), 0.3
    information = np.tile([[25.0], [400.0]], (500, QUANTITIES))
    sizes = 1.0 + variation * rng.standard_normal(information.shape)
    noise = np.sqrt(information) * rng.standard_normal(information.shape)
    section = np.repeat([0, 1], 500)
    found = block_statistics(sizes * information + noise, information, section)
    assert found.variation == pytest.approx(variation, rel=0.15)
    assert np.all(block_statistics(information + noise, information, section).variation < 0.3 * variation)
    assert np.all(np.isinf(block_statistics(sizes * information + noise, information, np.zeros(1000)).variation))
    few = ChangeTest(found._replace(remainder=np.ones(QUANTITIES), varied=np.full(QUANTITIES, 6)), 1000.0)
    many = ChangeTest(found._replace(remainder=np.ones(QUANTITIES)), 1000.0)
    blocks = []
    for test in (few, many):
        for _ in range(10):
            feed(test, 5.0 * INFORMATION * np.ones(QUANTITIES))
        blocks.append(test.change())
    assert blocks[0] is None
    assert blocks[1] is not None


def test_the_onset_is_sought_in_what_departs_alike():
    """An earlier long period of smaller departures is not part of it."""
    rng = np.random.default_rng(10)
    test = ChangeTest(healthy(), 1000.0, np.ones(QUANTITIES, dtype=np.bool_))
    for _ in range(200):
        feed(test, noise(rng, -1.0))
        assert test.change() is None
    for blocks in range(1, 40):  # noqa: B007
        feed(test, noise(rng, 0.5))
        if (found := test.change()) is not None:
            break
    assert found is not None
    assert found.earliest <= blocks + 1


def test_of_more_blocks_than_are_held_the_newest_count(monkeypatch):
    monkeypatch.setattr(rules, "LONGEST_WATCH", 20)
    rng = np.random.default_rng(14)
    long, short = ChangeTest(healthy(), 1000.0), ChangeTest(healthy(), 1000.0)
    for block in range(130):
        score = noise(rng, 0.25 if block >= 118 else 0.0)
        feed(long, score)
        if block >= 110:
            feed(short, score)
    long.learn(long.healthy)
    assert long.blocks == 20
    assert np.array_equal(long.rows(), short.rows())
    assert long.change() == pytest.approx(short.change())
    assert long.change().ratio > 1.0


def test_of_what_the_healthy_rig_told_nothing_no_change_is_told():
    rng = np.random.default_rng(6)
    test = ChangeTest(healthy(certainty=0.0), 1000.0)
    for _ in range(50):
        feed(test, noise(rng, 2.0))
    assert test.change() is None


def test_scatter_dependence_and_spread_are_those_of_the_blocks():
    """Three sections whose blocks follow an autoregression: the variance of their sum exceeds that of independent ones by 3."""
    rng, scatter, correlation, spread = np.random.default_rng(7), 2.0, 0.5, 0.4
    blocks, sections = 4000, 12
    level = spread * rng.standard_normal((sections, QUANTITIES))
    rest = np.zeros((sections * blocks, QUANTITIES))
    for row in range(1, len(rest)):
        rest[row] = correlation * rest[row - 1] + np.sqrt(1.0 - correlation**2) * rng.standard_normal(QUANTITIES)
    section = np.repeat(np.arange(sections), blocks)
    score = level[section] * INFORMATION + scatter * np.sqrt(INFORMATION) * rest
    found = block_statistics(score, np.full_like(score, INFORMATION), section)
    assert found.scatter == pytest.approx(scatter, rel=0.05)
    assert found.dependence == pytest.approx((1.0 + correlation) / (1.0 - correlation), rel=0.2)
    assert float(np.sqrt(np.mean(found.spread**2))) == pytest.approx(spread, rel=0.2)


def test_few_blocks_leave_a_wide_bound():
    rng = np.random.default_rng(8)
    scores = np.sqrt(INFORMATION) * rng.standard_normal((12, QUANTITIES))
    information = np.full_like(scores, INFORMATION)
    few = block_statistics(scores, information, np.zeros(12, dtype=np.intp))
    test = ChangeTest(few, 1000.0)
    before = test.bound
    test.learn(few._replace(freedom=1e4))
    assert before > 1.1 * test.bound
