"""The residual model of a healthy rig, learnt on plain arrays: a remainder, its spread, and its uncertainty elsewhere."""

import numpy as np
import pytest
from plain_evidence import MASS, assessed, evidence_of, nothing

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import share_closed
from ehls_ros.diagnosis.allowance import Allowance
from ehls_ros.diagnosis.coefficients import Term
from ehls_ros.diagnosis.discrepancy import SECTIONS, Windows, learn
from ehls_ros.diagnosis.evidence import Standard, allowing
from ehls_ros.diagnosis.healthy_variation import DescribedEvidence, HealthyVariation, RemainderTerms

NOISE, SPREAD, FITTED = 0.01, np.array([1e-3]), np.array([True])
ERROR = np.array([rules.LEFT_ERROR])


def made(seed, low=-1.0, high=1.0, level=0.0, windows=1200):
    """Return windows whose residual is a smooth curve over one signal, an error of one coefficient, and noise."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(low, high, windows)
    term = rng.standard_normal(windows)
    residual = curve(x) + level * term + NOISE * rng.standard_normal(windows)
    block = np.arange(windows) * 12 // windows
    return Windows(residual, np.full(windows, NOISE), term[:, None], x[:, None], np.ones(windows), block)


def curve(x):
    return 0.2 * np.sin(2.0 * x)


def expected(learnt, windows, growth=1.0):
    return learnt.expected(windows.terms, windows.signals, windows.factor, np.full(len(windows.residual), growth))


def test_a_smooth_remainder_is_learnt():
    learnt = learn([made(1)], SPREAD, ERROR, FITTED)
    other = made(2)
    found = expected(learnt, other)
    assert np.sqrt(np.mean((found.mean - curve(other.signals[:, 0])) ** 2)) < 0.4 * NOISE
    before, after = np.sqrt(learnt.power)
    assert before > 0.1
    assert after == pytest.approx(NOISE, rel=0.1)
    assert learnt.left < 0.5 * NOISE


def test_where_no_baseline_has_been_as_much_is_allowed_as_is_expected():
    learnt = learn([made(1)], SPREAD, ERROR, FITTED)
    far = learnt.expected(np.zeros((3, 1)), np.array([[0.5], [40.0], [400.0]]), np.ones(3), np.ones(3))
    deviation = np.sqrt(np.sum(far.directions**2, axis=1) + far.variance)
    assert far.mean[0] == pytest.approx(curve(0.5), abs=NOISE)
    assert abs(far.mean[2]) < 2.0 * deviation[2]
    assert deviation[2] > 3.0 * deviation[0]
    assert deviation[2] > 0.05


def test_a_linear_function_continues_although_the_oil_hardly_changes_its_temperature():
    """Orthogonal to a temperature's noise, functions would follow it."""
    rng = np.random.default_rng(5)

    def recording(low, high, kelvin):
        data = made(7, low, high)
        pressure, warmer = data.signals[:, 0], 1e-5 * rng.standard_normal(1200) + kelvin
        noise = NOISE * rng.standard_normal(1200)
        return data._replace(residual=0.1 * pressure + noise, terms=np.column_stack([np.ones(1200), warmer]))

    learnt = learn([recording(-0.3, 1.0, 0.0)], np.array([1e-3, 0.0]), np.full(2, rules.LEFT_ERROR), np.ones(2, bool))
    other = recording(-1.0, 1.0, 3e-5)
    found, true = expected(learnt, other), 0.1 * other.signals[:, 0]
    deviation = np.sqrt(np.sum(found.directions**2, axis=1) + found.variance)
    assert np.all(np.abs(found.mean - true) < 2.0 * deviation)
    np.testing.assert_allclose(found.mean, true, atol=0.05)


def test_errors_of_form_grow_and_those_of_coefficients_do_not():
    learnt, data = learn([made(1)], SPREAD, ERROR, FITTED), made(2)
    term, one, grown = data.terms[:, 0], expected(learnt, data), expected(learnt, data, growth=3.0)
    np.testing.assert_array_equal(grown.mean, one.mean)
    np.testing.assert_allclose(grown.variance, 9.0 * one.variance)
    along = [np.sum((e.directions.T @ term) ** 2) / (term @ term) for e in (one, grown)]
    assert along[1] < 4.0 * along[0]
    beside = [np.sum(e.directions**2) - coefficient for e, coefficient in zip((one, grown), along, strict=True)]
    assert beside[1] == pytest.approx(9.0 * beside[0], rel=0.05)


def test_what_a_coefficient_does_as_the_oil_warms_is_told_from_days_of_other_temperatures():
    # In units of the noise, of which a channel's largest term has a hundred.
    size, column = 100.0, 100.0 * np.random.default_rng(4).standard_normal(600)
    components = RemainderTerms(size, {"offset": 2e-4, "drag": rules.SPREAD_WITH_OIL}, (), "x", 1.0, 315.0)

    def day(kelvin):
        noise = np.random.default_rng(kelvin).standard_normal(600)
        evidence = evidence_of({"force": noise - 0.01 * (kelvin - 315) * column})
        signals = {"oil_temperature_k": np.full(600, float(kelvin))}
        return components.windows(
            DescribedEvidence(evidence, {"force": [Term("drag", column, 0.0)]}, {"force": signals}), "force"
        )

    learnt = components.learn_from([day(311), day(315), day(318)])
    warm = size * expected(learnt, day(322)).mean
    assert column @ warm / (column @ column) == pytest.approx(-0.07, rel=0.1)


def test_what_a_coefficient_can_do_no_function_does():
    data = made(1, level=0.04)
    learnt = learn([data], SPREAD, ERROR, FITTED)
    term = data.terms[:, 0]
    again = expected(learnt, data)
    assert again.mean @ term / (term @ term) == pytest.approx(data.residual @ term / (term @ term), abs=1e-3)
    varies = np.linalg.norm(again.directions.T @ term) / (term @ term)
    # Besides the spread, the error of the mean.
    assert SPREAD[0] <= varies < 1.5 * SPREAD[0]


def test_a_coefficient_that_is_not_fitted_may_be_off_where_no_baseline_has_been():
    data = made(1)
    held = data._replace(terms=np.ones_like(data.terms))
    learnt = learn([held], np.zeros(1), ERROR, np.array([False]))
    same, twice = (expected(learnt, held._replace(terms=held.terms * size)).directions for size in (1.0, 2.0))
    told, open_ = (float(np.linalg.norm(np.mean(d, axis=0))) for d in (same, twice))
    # The curve and the coefficient may share what was seen: the error is open within the curve's size.
    assert told < NOISE
    assert open_ > 5.0 * NOISE


def test_an_error_of_gain_is_learnt():
    data = made(1)
    factor = np.random.default_rng(3).standard_normal(len(data.residual))
    slope = data._replace(residual=data.residual + 0.1 * factor * data.signals[:, 0], factor=factor)
    before, after = learn([slope], SPREAD, ERROR, FITTED).power
    assert np.sqrt(before) > 0.1
    assert np.sqrt(after) == pytest.approx(NOISE, rel=0.2)


@pytest.mark.parametrize(("level", "drift"), [(0.0, 0.03), (0.4, 0.12)])
def test_what_drifts_within_an_only_recording_goes_on_drifting(level, drift):
    data = made(1, level=level, windows=3000)
    drifting = np.repeat([-drift, 0.0, drift], 1000)
    learnt = learn([data._replace(residual=data.residual + drifting * data.terms[:, 0])], SPREAD, ERROR, FITTED)
    assert learnt.spread[0] == pytest.approx(drift * np.sqrt(SECTIONS), rel=0.2)
    assert learn([data], SPREAD, ERROR, FITTED).spread[0] < 3.0 * SPREAD[0]


def test_recordings_that_differ_teach_the_spread():
    alike = learn([made(seed) for seed in (1, 2, 3)], SPREAD, ERROR, FITTED)
    apart = learn([made(seed, level=level) for seed, level in ((1, -0.03), (2, 0.0), (3, 0.03))], SPREAD, ERROR, FITTED)
    assert alike.spread[0] < 2.0 * SPREAD[0]
    assert apart.spread[0] == pytest.approx(0.03, rel=0.2)


def test_coefficients_that_replace_each_other_leave_their_sum_as_sure_as_it_is():
    rng = np.random.default_rng(6)
    pressure = rng.standard_normal(1200)
    # Pressure and discharge act nearly alike; from day to day, one takes the other's place by 10 %.
    terms = np.column_stack([pressure, pressure + 0.1 * rng.standard_normal(1200)])

    def day(seed, swapped):
        noise = NOISE * np.random.default_rng(seed).standard_normal(1200)
        return made(seed)._replace(residual=terms @ np.array([swapped, -swapped]) + noise, terms=terms)

    learnt = learn([day(1, 0.1), day(2, -0.1), day(3, 0.0)], np.full(2, 1e-3), np.full(2, rules.LEFT_ERROR), np.ones(2, bool))
    assert np.all(learnt.spread > 0.03)
    alike = np.linalg.norm(expected(learnt, day(4, 0.0)).directions.T @ pressure) / (pressure @ pressure)
    assert alike < 0.02


def test_functions_allow_a_coefficient_no_variation_in_another_motion():
    # In the only baseline the piston follows the load, so that a curve over the load resembles the coefficient's term.
    rng = np.random.default_rng(7)
    load = rng.uniform(-1.0, 1.0, 1200)
    following, free = load + 0.3 * rng.standard_normal(1200), 3.0 * rng.uniform(-1.0, 1.0, 1200)
    residual = curve(load) + NOISE * rng.standard_normal(1200)
    baseline = made(1)._replace(residual=residual, signals=load[:, None], terms=following[:, None])
    found = expected(learn([baseline], SPREAD, ERROR, FITTED), baseline._replace(terms=free[:, None]))
    assert np.linalg.norm(found.directions.T @ free) / (free @ free) < 3.0 * SPREAD[0]


def test_memory_counts_windows_that_err_together():
    rng = np.random.default_rng(5)
    data = made(1)
    steps = np.repeat(0.05 * rng.standard_normal(120), 10)
    slow = learn([data._replace(residual=data.residual + steps)], SPREAD, ERROR, FITTED)
    assert slow.left == pytest.approx(0.05, rel=0.2)
    assert 6.0 < slow.together < 15.0
    assert learn([data], SPREAD, ERROR, FITTED).together < 2.0


def test_an_allowed_direction_has_unit_variance_and_others_keep_theirs():
    windows = 600
    direction = np.sin(np.arange(windows) / 30.0)
    draws = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        e = rng.standard_normal(windows) + 3.0 * rng.standard_normal() * direction + 5.0
        allowance = Allowance(np.full(windows, 5.0), 3.0 * direction[:, None], np.zeros(windows))
        draws.append(allowing(evidence_of({"force": e}), {"force": allowance}, Standard()).base.values["force"])
    unit = direction / np.linalg.norm(direction)
    along = np.array(draws) @ unit
    assert np.std(along) == pytest.approx(1.0, rel=0.3)
    assert np.mean(np.array(draws) ** 2) == pytest.approx(1.0, rel=0.05)


def test_a_change_along_an_allowed_direction_is_as_large_as_ever():
    direction = np.sin(np.arange(600) / 30.0)
    allowance = Allowance(np.zeros(600), 3.0 * direction[:, None], np.zeros(600))
    evidence = evidence_of({"force": np.zeros(600)})
    judged = allowing(evidence, {"force": allowance}, Standard())
    reduced = judged.allowed["force"].whitened(direction)
    assert np.linalg.norm(reduced) < 0.1 * np.linalg.norm(direction)
    np.testing.assert_allclose(judged.whole("force", reduced), direction, atol=1e-9)


def test_of_a_change_along_what_varies_without_fault_all_is_closed():
    rng = np.random.default_rng(3)
    direction, scatter = np.sin(np.arange(600) / 30.0), rng.standard_normal(600)
    noise = {"force": 0.1 * rng.standard_normal(600)}
    allowance = Allowance(np.zeros(600), 3.0 * direction[:, None], np.zeros(600))
    evidence = evidence_of({"force": scatter + 30.0 * direction}, noise)
    judged = allowing(evidence, {"force": allowance}, HealthyVariation({}))
    cause = assessed((MASS,), {"force": judged.allowed["force"].whitened(scatter)}, [1.3])
    # By what exceeds the spread it would be 0.15.
    assert share_closed(judged, cause, nothing(judged)) > 0.99


def test_windows_that_err_together_tell_less_but_are_no_larger():
    remains = np.full(600, 3.0)
    allowance = Allowance(np.zeros(600), np.zeros((600, 1)), remains, correlated=12.0)
    judged = allowing(evidence_of({"force": np.zeros(600)}), {"force": allowance}, Standard())
    np.testing.assert_allclose(judged.floor["force"], 2.0)
    assert judged.correlation["force"] == pytest.approx((1.0 + 12.0 * 3.0) / 4.0)


def test_a_channel_without_allowance_is_left_out():
    quiet = np.random.default_rng(1).standard_normal(100)
    allowance = Allowance(np.zeros(100), np.zeros((100, 1)), np.zeros(100))
    judged = allowing(evidence_of({"force": quiet, "volume": quiet}), {"force": allowance}, Standard())
    assert judged.channels == ("force",)
    np.testing.assert_allclose(judged.base.values["force"], quiet)
