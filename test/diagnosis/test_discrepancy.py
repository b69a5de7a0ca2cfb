"""What a healthy rig leaves, learnt on plain arrays: a remainder, its spread, and nothing where it was never seen."""

import numpy as np
import pytest
from plain_evidence import evidence_of

from ehls_ros.diagnosis.allowance import Allowance
from ehls_ros.diagnosis.discrepancy import Windows, learn
from ehls_ros.diagnosis.evidence import allowing

NOISE, SPREAD = 0.01, np.array([1e-3])


def made(seed, low=-1.0, high=1.0, level=0.0, windows=1200):
    """Return windows whose residual is a smooth curve over one signal, an error of one coefficient, and noise."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(low, high, windows)
    term = rng.standard_normal(windows)
    residual = curve(x) + level * term + NOISE * rng.standard_normal(windows)
    block = np.arange(windows) * 12 // windows
    return Windows(residual, np.full(windows, NOISE), term[:, None], x[:, None], block)


def curve(x):
    return 0.2 * np.sin(2.0 * x)


def test_a_smooth_remainder_is_learnt():
    learnt = learn([made(1)], SPREAD)
    other = made(2)
    found = learnt.expected(other.terms, other.signals)
    assert np.sqrt(np.mean((found.mean - curve(other.signals[:, 0])) ** 2)) < 0.4 * NOISE
    before, after = np.sqrt(learnt.power)
    assert before > 0.1
    assert after == pytest.approx(NOISE, rel=0.1)
    assert learnt.left < 0.5 * NOISE


def test_where_no_baseline_has_been_nothing_is_expected_and_everything_allowed():
    learnt = learn([made(1)], SPREAD)
    far = learnt.expected(np.zeros((3, 1)), np.array([[0.5], [40.0], [400.0]]))
    deviation = np.sqrt(np.sum(far.directions**2, axis=1) + far.variance)
    assert far.mean[0] == pytest.approx(curve(0.5), abs=NOISE)
    assert abs(far.mean[2]) < 0.1 * abs(far.mean[0])
    assert deviation[2] > 3.0 * deviation[0]
    assert deviation[2] > 0.05


def test_an_error_of_a_coefficient_is_told_from_the_remainder():
    learnt = learn([made(1, level=0.04)], SPREAD)
    # The coefficient has to change by the opposite of what is left.
    assert learnt.errors[0] == pytest.approx(-0.04, abs=4.0 * learnt.deviations[0])
    assert learnt.deviations[0] < 1e-3


def test_recordings_that_differ_teach_the_spread():
    alike = learn([made(seed) for seed in (1, 2, 3)], SPREAD)
    apart = learn([made(seed, level=level) for seed, level in ((1, -0.03), (2, 0.0), (3, 0.03))], SPREAD)
    assert alike.spread[0] < 2.0 * SPREAD[0]
    assert apart.spread[0] == pytest.approx(0.03, rel=0.2)


def test_memory_counts_windows_that_err_together():
    rng = np.random.default_rng(5)
    data = made(1)
    steps = np.repeat(0.05 * rng.standard_normal(120), 10)
    slow = learn([data._replace(residual=data.residual + steps)], SPREAD)
    assert slow.left == pytest.approx(0.05, rel=0.2)
    assert 6.0 < slow.together < 15.0
    assert learn([data], SPREAD).together < 2.0


def test_an_allowed_direction_has_unit_variance_and_others_keep_theirs():
    windows = 600
    direction = np.sin(np.arange(windows) / 30.0)
    draws = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        e = rng.standard_normal(windows) + 3.0 * rng.standard_normal() * direction + 5.0
        allowance = Allowance(np.full(windows, 5.0), 3.0 * direction[:, None], np.zeros(windows))
        draws.append(allowing(evidence_of({"force": e}), {"force": allowance}, lambda evidence: evidence).base.values["force"])
    unit = direction / np.linalg.norm(direction)
    along = np.array(draws) @ unit
    assert np.std(along) == pytest.approx(1.0, rel=0.3)
    assert np.mean(np.array(draws) ** 2) == pytest.approx(1.0, rel=0.05)


def test_a_channel_without_allowance_is_left_out():
    quiet = np.random.default_rng(1).standard_normal(100)
    allowance = Allowance(np.zeros(100), np.zeros((100, 1)), np.zeros(100))
    judged = allowing(evidence_of({"force": quiet, "volume": quiet}), {"force": allowance}, lambda evidence: evidence)
    assert judged.channels == ("force",)
    np.testing.assert_allclose(judged.base.values["force"], quiet)
