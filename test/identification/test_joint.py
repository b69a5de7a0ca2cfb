"""The joint fit with a single-branch friction model, on motions with a known answer."""

import numpy as np
import pytest
from made_motions import PowerCoordinates, PowerLaw, motion, sine

from benchmarks.identification import least_covariance
from ehls_ros.identification import joint
from ehls_ros.identification.balance import Recorded
from ehls_ros.identification.joint import Problem, Start

TRUE = PowerLaw(100.0, 0.5)
START = Start(PowerCoordinates(), PowerLaw(40.0, 1.2), ("level", "exponent"))
LINEAR = {"viscous": 700.0, "constant": -30.0, "mass": 20.0}


def recorded(seeds=(0, 1), noise=0.0, linear=tuple(LINEAR)):
    """Two recordings with a time shift between them."""
    motions = []
    for seed in seeds:
        random = np.random.default_rng(seed)
        made = motion(sine(0.1 + 0.03 * (seed % 2), periods=20 + seed % 2))
        force = PowerCoordinates().force(made, TRUE) + LINEAR["viscous"] * made.velocity + LINEAR["constant"]
        force += LINEAR["mass"] * made.acceleration + noise * random.standard_normal(len(force))
        motions.append(made._replace(force=force, force_noise=max(noise, 1e-6), name=f"recording {seed}"))
    return Recorded(tuple(motions), tuple(m.resolved for m in motions), tuple(linear))


def problem(data):
    return Problem(data, START, START.coordinates.pack(START.friction), [2.0] * len(data.motions))


def test_the_linear_part_is_that_of_least_squares():
    data = recorded(noise=3.0)
    posed = problem(data)
    z = START.coordinates.pack(START.friction)
    unexplained = posed.unexplained(z)
    expected, *_ = np.linalg.lstsq(posed.rows, unexplained, rcond=None)
    np.testing.assert_allclose(posed.linear(z), expected, rtol=1e-9)
    np.testing.assert_allclose(posed.residuals(z), unexplained - posed.rows @ expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(posed.rows.T @ posed.residuals(z), 0.0, atol=1e-6)
    left = np.concatenate(posed.forces_left(z))
    np.testing.assert_allclose(left / 2.0, posed.residuals(z), rtol=1e-9, atol=1e-9)


def test_the_derivatives_are_those_of_the_formula():
    data = recorded()
    z = START.coordinates.pack(TRUE)
    v = np.concatenate([m.velocity for m in data.motions])
    force = TRUE.level * np.sign(v) * np.abs(v) ** TRUE.exponent / 2.0
    exact = np.column_stack([force, force * TRUE.exponent * np.log(np.maximum(np.abs(v), 1e-300))])
    design = problem(data).design(z)
    np.testing.assert_allclose(design[:, :2], exact, rtol=1e-12, atol=1e-12 * np.abs(force).max())
    np.testing.assert_array_equal(design[:, 2:], problem(data).rows)


def test_only_usable_blocks_count():
    data = recorded()
    spoilt = data.motions[0].force.copy()
    spoilt[100:200] = 1e9
    usable = data.usable[0].copy()
    usable[100:200] = False
    changed = Recorded((data.motions[0]._replace(force=spoilt), data.motions[1]), (usable, data.usable[1]), data.linear)
    fit = joint.fit(changed, START)
    assert fit.friction.level == pytest.approx(TRUE.level, rel=1e-5)
    assert np.all(np.isnan(fit.residuals[0][100:200]))


def test_noise_free_data_give_the_truth():
    fit = joint.fit(recorded(), START)
    np.testing.assert_allclose(fit.friction, TRUE, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(fit.linear, list(LINEAR.values()), rtol=1e-6)
    assert fit.converged
    assert fit.limited == ()


def test_what_is_not_free_stays():
    held = START._replace(friction=PowerLaw(40.0, TRUE.exponent), free=("level",))
    fit = joint.fit(recorded(), held)
    assert fit.friction.exponent == pytest.approx(TRUE.exponent, rel=1e-12)
    assert fit.friction.level == pytest.approx(TRUE.level, rel=1e-6)
    assert fit.covariance.shape == (4, 4)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_forces_in_another_unit_give_coefficients_in_that_unit(unit):
    data = recorded(noise=2.0)
    motions = tuple(m._replace(force=unit * m.force, force_noise=unit * m.force_noise) for m in data.motions)
    fit = joint.fit(data, START)
    scaled = joint.fit(data._replace(motions=motions), START._replace(friction=PowerLaw(40.0 * unit, 1.2)))
    assert scaled.friction.level == pytest.approx(unit * fit.friction.level, rel=1e-6)
    assert scaled.friction.exponent == pytest.approx(fit.friction.exponent, rel=1e-6)
    np.testing.assert_allclose(scaled.linear, unit * fit.linear, rtol=1e-6)
    factor = np.array([1.0, 1.0, unit, unit, unit])
    np.testing.assert_allclose(scaled.covariance, fit.covariance * np.outer(factor, factor), rtol=1e-3, atol=1e-12)


def test_neither_the_order_of_recordings_nor_their_clocks_matter():
    data = recorded(noise=2.0)
    later = data.motions[0]._replace(time=data.motions[0].time + 1e6)
    other = Recorded((data.motions[1], later), data.usable[::-1], data.linear)
    fit, turned = joint.fit(data, START), joint.fit(other, START)
    np.testing.assert_allclose(turned.z, fit.z, rtol=1e-7)
    np.testing.assert_allclose(turned.covariance, fit.covariance, rtol=1e-4, atol=1e-10)
    assert turned.noise == pytest.approx(fit.noise[::-1])


@pytest.mark.long
def test_intervals_hold_as_often_as_they_say():
    true = np.array([np.log(TRUE.level), np.log(TRUE.exponent), *LINEAR.values()])
    held = []
    for seed in range(100):
        fit = joint.fit(recorded((2 * seed, 2 * seed + 1), noise=5.0), START)
        held.append(np.abs(np.append(fit.z, fit.linear) - true) <= 1.96 * np.sqrt(np.diag(fit.covariance)))
    # Of 500 intervals 95 % hold, within three standard deviations of that number.
    assert 0.92 <= np.mean(held) <= 0.98


def test_stray_blocks_are_left_out_and_hardly_move_the_result():
    data = recorded(noise=2.0)
    stray = data.motions[0].force.copy()
    stray[::50] += 3e3
    spoilt = joint.fit(data._replace(motions=(data.motions[0]._replace(force=stray), data.motions[1])), START)
    assert np.all(np.isnan(spoilt.residuals[0][::50]))
    assert np.isfinite(spoilt.residuals[0]).mean() > 0.97
    clean = joint.fit(data, START)
    assert np.all(np.abs(spoilt.z - clean.z) < 0.5 * np.sqrt(np.diag(clean.covariance))[:2])


def test_a_search_that_ends_at_its_limit_says_so():
    far = START._replace(friction=PowerLaw(TRUE.level * np.exp(5.0), TRUE.exponent), free=("level",))
    fit = joint.fit(recorded(), far)
    assert fit.limited == ("level",)


def test_correlated_blocks_count_once():
    data = recorded(noise=0.0)
    random = np.random.default_rng(3)
    slow = np.repeat(random.standard_normal(200), 10) * 5.0
    motions = tuple(m._replace(force=m.force + np.roll(slow, 137 * i)) for i, m in enumerate(data.motions))
    fit = joint.fit(data._replace(motions=motions), START)
    assert fit.blocks == pytest.approx(400.0, rel=0.25)


def test_strokes_are_numbered_through_all_recordings():
    made = motion(np.array([1.0, 1.0, -1.0, -1.0, 1.0]))
    usable = np.array([True, False, True, True, True])
    data = Recorded((made, made), (usable, ~usable), ("constant",))
    assert joint.strokes(data).tolist() == [0, 1, 1, 2, 3]


def test_two_fits_make_one():
    data = recorded(noise=2.0)
    first = joint.fit(data.chosen([1]), START._replace(free=("level",)))
    then = START._replace(friction=first.friction, free=("exponent",))
    second = joint.fit(data.chosen([0]), then)
    moved = joint.moved_with_held(second, data.chosen([0]))
    both = joint.combined(joint.placed(first, [1], data.motions), joint.placed(second, [0], data.motions), moved)
    assert both.free == ("level", "exponent")
    np.testing.assert_array_equal(both.linear, first.linear)
    np.testing.assert_array_equal(both.z, second.z)
    np.testing.assert_array_equal(both.covariance[np.ix_([0, 2, 3, 4], [0, 2, 3, 4])], first.covariance)
    np.testing.assert_allclose(both.covariance[1, [0, 2, 3, 4]], moved[0, 0] * first.covariance[0])
    assert both.covariance[1, 1] == pytest.approx(second.covariance[0, 0] + moved[0, 0] ** 2 * first.covariance[0, 0])
    np.testing.assert_allclose(both.covariance, both.covariance.T)
    assert both.noise == (*second.noise, *first.noise)
    np.testing.assert_array_equal(both.residuals, [second.residuals[0], first.residuals[0]])
    assert both.cost == first.cost + second.cost


def test_what_a_fit_held_moves_what_it_found():
    data = recorded(noise=2.0)
    step = 1e-3
    held = [START._replace(friction=TRUE._replace(level=TRUE.level * np.exp(by)), free=("exponent",)) for by in (-step, step)]
    low, high = (joint.fit(data, start) for start in held)
    moved = joint.moved_with_held(low, data)
    assert moved.shape == (1 + len(low.linear), 1)
    assert moved[0, 0] == pytest.approx((high.z[1] - low.z[1]) / (2.0 * step), rel=0.05)
    linear = (high.linear - low.linear) / (2.0 * step)
    np.testing.assert_allclose(moved[1:, 0], linear, rtol=0.05, atol=1e-3 * np.abs(moved).max())


def test_a_recording_that_did_not_count_has_no_residuals():
    data = recorded()
    fit = joint.placed(joint.fit(data.chosen([1]), START), [1], data.motions)
    assert np.isnan(fit.noise[0])
    assert np.isnan(fit.residuals[0]).all()
    assert len(fit.residuals[0]) == len(data.motions[0].force)
    assert np.isfinite(fit.residuals[1]).any()


def test_the_bound_of_white_noise_is_below_what_a_fit_reports():
    data = recorded(noise=2.0)
    fit = joint.fit(data, START)
    bound = np.sqrt(np.diag(least_covariance(fit, data.motions)))
    reported = np.sqrt(np.diag(fit.covariance))
    assert np.all(bound < 1.5 * reported)
    np.testing.assert_allclose(reported, bound, rtol=0.6)
