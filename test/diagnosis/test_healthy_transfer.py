"""Errors of the healthy remainder's expectation in a recording that it was not learnt from."""

import numpy as np
import pytest

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.discrepancy import Expected, Windows, learn
from ehls_ros.diagnosis.healthy_variation import ChannelRemainder, RemainderTerms

NOISE = 1e-3
NONE = np.ones(1, dtype=np.bool_)


def windows(seed, residual, *, low=-1.0, high=1.0, n=600):
    """Return windows over a signal that is drawn evenly from a range."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(low, high, n)
    noise = np.full(n, NOISE)
    return Windows(
        residual(x) + NOISE * rng.standard_normal(n), noise, np.ones((n, 1)), x[:, None], np.zeros(n), np.arange(n) // 60
    )


def learnt(*recordings):
    components = RemainderTerms(1.0, {"offset": 1e-6}, ("signal",), "signal", 1.0, None)
    found = ChannelRemainder(components, learn(recordings, np.array([1e-6]), np.array([rules.LEFT_ERROR]), NONE))
    return found.with_transfer({f"baseline {i}": recording for i, recording in enumerate(recordings)})


def bend(x):
    return 0.02 * x**2


def test_what_the_baselines_share_is_expected_in_the_next_one():
    assert learnt(windows(1, bend), windows(2, bend)).transfer < NOISE


def test_their_difference_is_the_error_of_the_expectation():
    found = learnt(windows(1, bend), windows(2, lambda x: bend(x) + 0.01 * np.sin(3.0 * x)))
    # The expectation from one recording misses all of what the other has beyond it.
    assert found.transfer == pytest.approx(0.01 * np.sqrt(0.5), rel=0.2)


def equally_sure(deviation):
    return Expected(np.zeros(4), np.zeros((4, 0)), np.full(4, deviation**2))


def test_the_error_lies_within_one_and_the_most_standard_deviations_of_the_expectation():
    found = learnt(windows(1, bend), windows(2, lambda x: bend(x) + 0.01 * np.sin(3.0 * x)), windows(3, bend))
    assert found.form(equally_sure(1e-4), new=False) == pytest.approx(found.most(new=False) * 1e-4)
    assert found.form(equally_sure(0.9 * found.transfer), new=False) == found.transfer
    assert found.form(equally_sure(1.0), new=False) == pytest.approx(1.0)


def test_of_another_programme_the_baselines_errors_say_nothing():
    several = learnt(windows(1, bend), windows(2, bend))
    assert several.form(equally_sure(1.0), new=True) == pytest.approx(several.most(new=True))
    only = learnt(windows(1, bend))
    assert only.form(equally_sure(1.0), new=True) == only.elsewhere


def test_an_error_below_the_noise_that_lasts_is_seen():
    low = 0.3 * NOISE
    found = learnt(*(windows(k, lambda x, sign=sign: np.full_like(x, sign * low)) for k, sign in ((1, -1.0), (2, 1.0))))
    assert found.transfer == pytest.approx(2.0 * low, rel=0.2)


def test_a_single_baseline_tells_nothing_of_another_programme():
    found = learnt(windows(1, bend))
    whole = float(np.sqrt(np.mean(bend(found.learnt.windows.signals) ** 2)))
    assert found.transfer < 0.1 * whole
    assert found.elsewhere == pytest.approx(rules.OTHER_PROGRAMME * whole, rel=0.05)


def test_of_windows_in_one_section_the_whole_remainder_may_be_another():
    short = windows(1, bend)
    found = learnt(short._replace(block=np.full_like(short.block, 7)))
    assert found.transfer == pytest.approx(float(np.sqrt(np.mean(bend(short.signals) ** 2))), rel=0.05)


@pytest.mark.parametrize(("high", "known"), [(1.0, True), (2.0, True), (3.0, True), (7.0, False)])
def test_a_programme_is_known_by_the_range_of_its_signals(high, known):
    found = learnt(windows(1, bend), windows(2, bend, high=3.0))
    assert found.is_known(windows(3, bend, high=high)) == known
