"""Errors of the healthy remainder's expectation in a recording that it was not learnt from."""

import numpy as np
import pytest

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.coefficients import RelativeErrors
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
    return found.compared({f"baseline {i}": recording for i, recording in enumerate(recordings)})


def bend(x):
    return 0.02 * x**2


def test_where_the_baselines_agree_their_expectation_is_as_good_as_it_says():
    assert learnt(windows(1, bend), windows(2, bend)).misjudged < 1.3


def test_baselines_further_apart_than_their_spread_says_widen_what_may_vary():
    found = learnt(windows(1, bend), windows(2, lambda x: bend(x) + 0.01 * np.sin(3.0 * x)), windows(3, bend))
    narrow = found._replace(learnt=found.learnt._replace(changing=np.full_like(found.learnt.changing, 0.01), left=1e-4))
    again = narrow.compared({"baseline 0": windows(1, bend), "baseline 1": windows(3, bend)})
    assert again.misjudged > 2.0 * found.misjudged
    assert again.most(new=False) == rules.MAX_ALLOWED * again.misjudged


def test_an_error_below_the_noise_that_lasts_is_seen():
    low = 0.3 * NOISE
    found = learnt(*(windows(k, lambda x, sign=sign: np.full_like(x, sign * low)) for k, sign in ((1, -1.0), (2, 1.0))))
    narrow = found._replace(learnt=found.learnt._replace(varying=1e-6 * found.learnt.varying, left=1e-6))
    assert narrow.compared({}).misjudged > found.misjudged


def test_the_error_of_form_is_what_varies_from_window_to_window():
    found = learnt(windows(1, bend), windows(2, bend))
    expected = Expected(np.zeros(4), np.full((4, 1), 0.1), np.array([1e-6, 1e-6, 4e-6, np.inf]))
    assert found.form(expected, new=False) == pytest.approx(np.sqrt(2e-6))
    assert found.form(expected, new=True) == pytest.approx(rules.OTHER_PROGRAMME * np.sqrt(2e-6))


def test_a_single_baseline_tells_little_of_another_programme():
    only, several = learnt(windows(1, bend)), learnt(windows(1, bend), windows(2, bend))
    assert only.most(new=True) == rules.OTHER_PROGRAMME * only.most(new=False)
    assert several.most(new=True) == several.most(new=False)


def test_of_windows_in_one_section_the_remainder_may_vary_without_bounds():
    short = windows(1, bend)
    assert learnt(short._replace(block=np.full_like(short.block, 7))).most(new=False) == np.inf


@pytest.mark.parametrize(("high", "known"), [(1.0, True), (2.0, True), (3.0, True), (7.0, False)])
def test_a_programme_is_known_by_the_range_of_its_signals(high, known):
    found = learnt(windows(1, bend), windows(2, bend, high=3.0))
    assert found.is_known(windows(3, bend, high=high)) == known


@pytest.mark.parametrize(("times", "error", "known"), [(1.5, 0.1, True), (8.0, 0.1, False), (8.0, 1e-5, True)])
def test_a_programme_that_shows_an_error_of_a_coefficient_that_the_baselines_hide_is_another(times, error, known):
    found = learnt(windows(1, bend), windows(2, bend))
    found = found._replace(terms=found.terms._replace(identified=np.array([[error]])))
    new = windows(3, bend)
    assert found.is_known(new._replace(terms=times * new.terms)) == known


def test_static_friction_is_off_by_what_its_ratio_to_the_coulomb_friction_is():
    """The term of the Coulomb friction moves both."""
    deviations = np.array([[0.1, 0.0], [0.1, 0.02]])
    errors = RelativeErrors(("coulomb_force", "static_force"), deviations @ deviations.T)
    found = errors.in_terms(("offset", "static_force", "coulomb_force"))
    assert found @ found.T == pytest.approx(np.diag([0.0, 0.02**2, 0.1**2]), abs=1e-15)


def test_beyond_the_baselines_more_may_vary_even_where_they_agree():
    found = learnt(windows(1, np.zeros_like), windows(2, np.zeros_like))
    inside, outside = (found.expected(windows(3, np.zeros_like, low=where, high=where + 0.01)).variance for where in (0.5, 1.6))
    assert np.all(outside > inside + (0.4 * rules.RELEVANT) ** 2)
