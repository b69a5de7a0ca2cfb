"""Held-out blocks: against fits that leave each block out, and parameters against their scatter."""

import numpy as np
import pytest
from plain_evidence import MASS, candidate, evidence_of, linear_fit, nothing
from scipy.optimize import lsq_linear, minimize

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.held_out import leave_out
from ehls_ros.diagnosis.loss import loss


def linear_case(seed=3, blocks=6, rows=20, scale=0.4):
    """Return derivatives, residuals of the given model, those of the fit, its parameters and the block of each."""
    rng = np.random.default_rng(seed)
    n = blocks * rows
    j = rng.standard_normal((n, 2)) * [1.0, 50.0]
    base = scale * rng.standard_normal(n) + j @ [0.5, -0.01]
    values = -np.linalg.lstsq(j, base, rcond=None)[0]
    return j, base, base + j @ values, values, np.repeat(np.arange(blocks), rows)


def test_a_linear_fit_without_a_block_is_exact():
    j, _, e, _, block = linear_case()
    assert np.max(np.abs(e)) < rules.HUBER
    without, _ = leave_out(j, e, block, 6, np.ones(len(e)))
    hat = j @ np.linalg.solve(j.T @ j, j.T)
    for b in range(6):
        inside = block == b
        # The prediction residuals of least squares (Allen's PRESS), block by block.
        own = np.eye(int(inside.sum())) - hat[np.ix_(inside, inside)]
        np.testing.assert_allclose(without[inside], np.linalg.solve(own, e[inside]), rtol=1e-9)


def test_a_robust_fit_without_a_block_is_right_to_first_order():
    j, base, _, _, block = linear_case()
    base[[5, 47]] += 30.0
    whole = minimize(lambda v: float(np.sum(loss(base + j @ v))), [-0.5, 0.01], tol=1e-14).x
    without, _ = leave_out(j, base + j @ whole, block, 6, np.ones(len(base)))
    for b in range(6):
        inside = block == b
        others = minimize(lambda v, out=~inside: float(np.sum(loss((base + j @ v)[out]))), whole, tol=1e-14).x
        np.testing.assert_allclose(without[inside], base[inside] + j[inside] @ others, atol=0.02)


def test_a_fit_without_a_block_stays_within_the_bounds():
    j, base, _, whole, block = linear_case()
    # The first parameter is at its bound; the second meets one without some blocks.
    low, high = np.array([-0.3, whole[1] - 1e-4]), np.array([1.0, whole[1] + 1e-4])
    values = lsq_linear(j, -base, (low, high)).x
    assert values[0] == pytest.approx(low[0])
    values[0] = low[0]
    e = base + j @ values
    without, _ = leave_out(j, e, block, 6, np.ones(len(e)), (low - values, high - values))
    moved = [np.linalg.lstsq(j[block == b], (without - e)[block == b], rcond=None)[0] for b in range(6)]
    for b, shift in enumerate(moved):
        others = lsq_linear(j[block != b], -base[block != b], (low, high)).x
        np.testing.assert_allclose(values + shift, others, atol=2e-5)


def test_the_gain_is_that_of_each_block():
    j, base, _, _, block = linear_case()
    evidence = evidence_of({"force": base}, blocks=6)
    held_out = linear_fit(evidence, (candidate("stribeck_shift", "static_offset", "velocity_factor"),), j).held_out
    after = held_out.residuals.values["force"]
    for b in range(6):
        inside = block == b
        assert held_out.gain["force"][b] == pytest.approx(float(np.sum(loss(base[inside]) - loss(after[inside]))))


def test_a_hypothesis_without_causes_gains_nothing():
    assessed = nothing(evidence_of({"force": np.ones(60)}))
    assert assessed.score({"force": 1.0}) == 0.0
    assert assessed.names == ()


def test_channels_that_a_hypothesis_does_not_change_keep_their_residuals():
    rng = np.random.default_rng(1)
    evidence = evidence_of({"force": rng.standard_normal(240), "spool": rng.standard_normal(60)})
    held_out = linear_fit(evidence, (MASS,), rng.standard_normal((240, 1))).held_out
    assert set(held_out.gain) == {"force"}
    np.testing.assert_array_equal(held_out.residuals.values["spool"], evidence.base.values["spool"])


def test_a_score_divides_by_inflation_and_charges_parameters():
    rng = np.random.default_rng(1)
    column = rng.standard_normal((240, 1))
    evidence = evidence_of({"force": 2.0 * column[:, 0]})
    assessed = linear_fit(evidence, (MASS,), column)
    total = float(np.sum(loss(evidence.base.values["force"])))
    assert assessed.score({"force": 1.0}) == pytest.approx(total - rules.PENALTY)
    assert assessed.score({"force": 4.0}) == pytest.approx(total / 4.0 - rules.PENALTY)


def test_noise_has_no_excess_and_a_model_error_has():
    evidence = evidence_of({"force": np.full(240, 2.0)})
    noise = float(np.sum(loss(evidence.noise["force"])))
    assert nothing(evidence).excess(evidence, "force") == pytest.approx(480.0 - rules.LITTLE * noise)
    assert nothing(evidence_of({"force": np.zeros(240)})).excess(evidence_of({"force": np.zeros(240)}), "force") == 0.0


def test_parameters_scatter_as_their_covariance_says():
    found, said = [], []
    for seed in range(300):
        j, _, e, values, block = linear_case(seed, blocks=12, scale=1.0)
        found.append(values)
        said.append(np.sqrt(np.diag(leave_out(j, e, block, 12, np.ones(len(e)))[1])))
    # The disagreement between blocks can only widen an error estimate, and the blocks are few.
    ratio = np.std(found, axis=0) / np.mean(said, axis=0)
    np.testing.assert_allclose(ratio, 0.9, atol=0.12)


def test_residuals_that_scatter_more_widen_the_errors():
    j, _, e, _, block = linear_case()
    _, covariance = leave_out(j, e, block, 6, np.full(len(e), 100.0))
    # So much that it exceeds the blocks' disagreement: the covariance of least squares.
    np.testing.assert_allclose(covariance, 100.0 * np.linalg.inv(j.T @ j), rtol=1e-9)


def test_blocks_that_disagree_widen_the_errors():
    j, _, e, _, block = linear_case(blocks=12)
    disturbed = e + j[:, 0] * np.where(block % 2, 1.0, -1.0)
    plain, wide = (leave_out(j, r, block, 12, np.ones(len(e)))[1] for r in (e, disturbed))
    assert wide[0, 0] > 5.0 * plain[0, 0]


def test_sigmas_are_those_of_the_best_determined_combination_of_parameters():
    rng = np.random.default_rng(4)
    total, difference = rng.standard_normal((2, 240))
    # Two gains: their sum hardly matters, their difference does.
    j = np.column_stack([0.01 * total + difference, 0.01 * total - difference])
    evidence = evidence_of({"force": rng.standard_normal(240) - j @ [0.5, -0.5]})
    assessed = linear_fit(evidence, (candidate("valve_gain_asymmetry", "opening_positive", "opening_negative"),), j)
    alone = np.abs(assessed.fit.values) / np.sqrt(np.diag(assessed.held_out.covariance))
    assert max(alone) < 3.0
    # Both change a window by the difference times 1, with a scatter of 1 in each of 240 windows.
    assert assessed.sigmas(0) == pytest.approx(np.sqrt(240), rel=0.3)


def test_a_parameter_that_changes_nothing_is_no_standard_error_from_neutral():
    j, base, _, _, _ = linear_case()
    j[:, 1] = 0.0
    found = linear_fit(evidence_of({"force": base}, blocks=6), (candidate("stribeck_shift", "offset", "factor"),), j)
    found.fit.values[:] = 0.0, 3.0
    assert found.sigmas(0) == 0.0


def test_a_mass_on_a_spring_of_unknown_stiffness_is_no_cause():
    rng = np.random.default_rng(5)
    smoother, softer = rng.standard_normal((2, 240))
    for weight, known in ((1e-3, False), (1.0, True)):
        # Per kg and per Hz; the motion of the mass is smoother than measured, whatever its frequency.
        j = np.column_stack([smoother, weight * softer])
        evidence = evidence_of({"force": rng.standard_normal(240) - j @ [60.0, 200.0]})
        found = linear_fit(evidence, (candidate("flexible_mode", "mass", "frequency"),), j)
        assert (found.sigmas(0) > rules.MIN_SIGMAS) == known
