"""Fits: bounded steps, reuse of derivatives, and the start of a fit beside another cause."""

from contextlib import closing

import numpy as np
import pytest

from ehls_ros.diagnosis.held_out import assess
from ehls_ros.diagnosis.hypotheses import extended
from ehls_ros.diagnosis.loss import gauss_newton, linear_loss, loss, products
from ehls_ros.diagnosis.pool import Pool
from ehls_ros.diagnosis.stages import Comparison
from ehls_ros.diagnosis.starts import Starts, combined, try_starts


def test_gauss_newton_finds_what_enters_linearly(worker_of):
    worker, found = worker_of({"spring_rate_shift": {"factor": 1.2}})
    spring = found["spring_rate_shift", 0]
    done = worker.fit(worker.linearise((spring,), spring.neutral))
    assert done.settled
    assert done.channels == ("force",)
    assert done.values[spring.free.index("added")] == pytest.approx(8000.0, rel=0.01)
    assert done.loss < 0.01 * float(np.sum(loss(worker.evidence.base.values["force"])))


def test_gauss_newton_finds_a_kink(worker_of):
    worker, found = worker_of({"valve_dead_zone": {"positive": 4e-5, "negative": 3e-5, "site": "ports"}})
    overlap = found["valve_dead_zone", 0]
    reached = [worker.fit(worker.linearise((overlap,), start)) for start in overlap.starts]
    best = min(reached, key=lambda f: f.loss)
    np.testing.assert_allclose(best.values, [4e-5, 3e-5], rtol=0.05)
    assert np.all(best.values >= overlap.lower)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_derivatives_are_those_on_the_side_to_which_a_fit_moves(worker_of, rig, side):
    worker, found = worker_of({})
    lag = found["valve_bandwidth_shift", 0]
    values = np.array([1.2])
    again = worker.linearise_again(worker.linearise((lag,), values - 0.1 * side), values)
    there, here = (worker.residuals(extended(worker.evidence.rig, (lag,), v)) for v in (values + side * again.steps, values))
    quotient = (there.joined(again.channels) - here.joined(again.channels)) / (side * again.steps[0])
    np.testing.assert_allclose(again.jacobian[:, 0], quotient, rtol=1e-9, atol=1e-9)


def test_what_does_not_depend_on_a_change_is_reused(worker_of, rig, monkeypatch):
    worker, found = worker_of({"spring_rate_shift": {"factor": 1.2}, "valve_hysteresis": {"width": 2e-5}})
    spring, valve = found["spring_rate_shift", 0], found["valve_hysteresis", 0]
    alone = worker.fit(worker.linearise((spring,), spring.neutral))
    both = np.concatenate([alone.values, valve.starts[-1]])
    begin = worker.linearise((spring, valve), both)
    moved = both * np.where(np.arange(len(both)) < len(alone.values), 1.0, 1.1)
    fresh = worker.linearise((spring, valve), moved, begin.steps)

    def unasked(self, rig):
        raise AssertionError

    with monkeypatch.context() as patch:
        patch.setattr(Comparison, "_force", unasked)
        again = worker.linearise_again(begin, moved)
        done = worker.fit(again)
    np.testing.assert_allclose(again.jacobian, fresh.jacobian, rtol=1e-6, atol=1e-6 * np.max(np.abs(fresh.jacobian)))
    # The settled one stays, while the other continues.
    np.testing.assert_array_equal(done.values[: len(alone.values)], alone.values)
    assert done.values[-1] == pytest.approx(2e-5, rel=0.1)


def test_a_fit_that_starts_where_its_causes_do_nothing_stays_there(worker_of):
    worker, found = worker_of({"spring_hardening": {"cubic": -2e5}})
    never = next(c for c in found.values() if c.name == "end_stop" and len(c.free) > 1)
    begin = worker.linearise((never,), never.neutral)
    assert begin.channels == ()
    done = worker.fit(begin)
    assert done.settled
    np.testing.assert_array_equal(done.values, never.neutral)
    assert sum(gain.sum() for gain in assess(worker.evidence, done, worker).held_out.gain.values()) == 0.0


def test_causes_that_all_but_cancel_are_fitted_from_where_they_do(worker_of):
    worker, found = worker_of({"mass_shift": {"factor": 0.94}, "constant_load": {"force": -45.0}})
    load, mass = found["constant_load", 0], found["mass_shift", 0]
    alone = worker.fit(worker.linearise((load,), load.neutral))
    begin = combined(worker.evidence, alone, worker.linearise((mass,), mass.neutral))
    assert begin.promise > 100.0
    # The promised reduction is there at the first step, not only after the fit.
    assert alone.loss - worker.first_step(begin).loss > 0.8 * begin.promise


def test_a_cause_starts_otherwise_beside_what_hid_it(worker_of):
    hidden = {"presliding_stiffness_shift": {"factor": 4.7}, "pressure_sensor_lag": {"time_constant": 0.012}}
    worker, found = worker_of(hidden)
    few = [found["presliding_stiffness_shift", 0], found["pressure_sensor_lag", 0]]
    with closing(Pool(worker.evidence, 1)) as pool:
        starts = Starts(pool, try_starts(pool, few, lambda what, part: None))
        lag = worker.fit(next(f for f in starts.alone if f.hypothesis == (few[1],)))
        beside = starts.beside(assess(worker.evidence, lag))
    alone, after = (next(f.values[0] for f in fits if f.hypothesis == (few[0],)) for fits in (starts.alone, beside))
    # The start nearest to the truth, which the lag's error had covered.
    assert after == min(few[0].starts[:, 0], key=lambda start: abs(np.log(start / 4.7)))
    assert alone < after


def test_derivatives_follow_a_step_without_being_evaluated_again(worker_of, rig):
    worker, found = worker_of({"hinge_backlash": {"gap": 3e-4}})
    play = next(c for c in found.values() if c.name == "hinge_backlash" and c.separates_load)
    begin = worker.linearise((play,), play.starts[-1])
    moved = np.clip(begin.values * 1.02, play.lower, play.upper)
    errors = worker.residuals(extended(worker.evidence.rig, (play,), moved), begin.residuals)
    after = worker._updated(begin, moved, errors, 0.0)
    change = errors.joined(begin.channels) - begin.residuals.joined(begin.channels)
    assert np.linalg.norm(change - begin.jacobian @ (moved - begin.values)) > 0.05 * np.linalg.norm(change)
    np.testing.assert_allclose(after.jacobian @ (moved - begin.values), change, rtol=1e-6, atol=1e-6)


def test_a_step_stays_within_the_ranges():
    j, e = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]), np.array([1.0, -2.0, 0.0])
    lower, upper = np.zeros(2), np.full(2, 10.0)
    step = gauss_newton(j, e, 0.0, np.zeros(2), lower, upper)
    # Unbounded it would go to negative values of the first; held at 0, the second alone is least squares.
    np.testing.assert_allclose(step, [0.0, 1.0], atol=1e-9)


@pytest.mark.parametrize("spoilt", [np.nan, np.inf, 1e200])
def test_a_diverged_model_gives_no_step(spoilt):
    rng = np.random.default_rng(3)
    j, e = rng.standard_normal((50, 2)), rng.standard_normal(50)
    j[7, 1] = spoilt
    wide = np.full(2, 1e6)
    np.testing.assert_array_equal(gauss_newton(j, e, 0.0, np.zeros(2), -wide, wide), [0.0, 0.0])


def test_an_undamped_step_solves_a_linear_problem():
    rng = np.random.default_rng(2)
    j, wide = rng.standard_normal((200, 3)) * [1.0, 1e6, 1e-6], np.full(3, 1e30)
    e = 0.2 * rng.standard_normal(200) + j @ [0.1, 2e-7, 3e5]
    assert np.max(np.abs(e)) < 3.0
    step = gauss_newton(j, e, 0.0, np.zeros(3), -wide, wide)
    np.testing.assert_allclose(step, -np.linalg.lstsq(j, e, rcond=None)[0], rtol=1e-6)
    assert linear_loss(e, j, step) == pytest.approx(0.5 * float(np.sum((e + j @ step) ** 2)), rel=1e-12)


def test_damping_shortens_a_step():
    j, e, wide = np.array([[2.0], [0.0]]), np.array([1.0, 1.0]), np.array([9.0])
    steps = [gauss_newton(j, e, damping, np.zeros(1), -wide, wide)[0] for damping in (0.0, 1.0, 3.0)]
    np.testing.assert_allclose(steps, [-0.5, -0.25, -0.125])


def test_weighted_products_are_the_matrices():
    rng = np.random.default_rng(5)
    j, w, e = rng.standard_normal((30, 3)), rng.random(30), rng.standard_normal(30)
    normal, gradient = products(j, w, e)
    np.testing.assert_allclose(normal, j.T @ np.diag(w) @ j)
    np.testing.assert_allclose(gradient, j.T @ (w * e))
