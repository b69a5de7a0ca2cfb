"""Covariance of least squares: known answers, invariances, and intervals with their nominal coverage."""

import numpy as np
import pytest

from ehls_ros.identification.covariance import PRIOR_STD, clustered_covariance, correlation_time, normal_covariance

TRUTH = np.array([2.0, -1.0])


def regression(blocks: int = 400) -> np.ndarray:
    phase = np.linspace(0.0, 40.0, blocks)
    return np.column_stack([np.ones(blocks), np.sin(phase)])


def coverage(rows: np.ndarray, noises: list[np.ndarray], clusters: np.ndarray | None) -> np.ndarray:
    """Return the coverage of the 95 % interval of each coefficient, over many draws of the noise."""
    held = []
    for noise in noises:
        y = rows @ TRUTH + noise
        found, *_ = np.linalg.lstsq(rows, y, rcond=None)
        covariance = (
            normal_covariance(rows, 0) if clusters is None else clustered_covariance(rows, y - rows @ found, clusters, 0)
        )
        held.append(np.abs(found - TRUTH) <= 1.96 * np.sqrt(np.diag(covariance)))
    return np.mean(held, axis=0)


def test_independent_residuals_have_the_textbook_covariance():
    rows = regression()
    np.testing.assert_allclose(normal_covariance(rows, 0), np.linalg.inv(rows.T @ rows), rtol=1e-10)


def test_a_coordinate_without_data_is_doubted_and_blurs_no_other():
    rows = np.column_stack([np.zeros(400), regression()])
    covariance = normal_covariance(rows, 1)
    assert covariance[0, 0] == pytest.approx(PRIOR_STD**2)
    np.testing.assert_allclose(covariance[1:, 1:], np.linalg.inv(regression().T @ regression()), rtol=1e-10)


def test_a_coordinate_without_data_is_doubted_whatever_the_clusters():
    random = np.random.default_rng(0)
    rows = np.column_stack([np.zeros(400), regression()])
    covariance = clustered_covariance(rows, random.standard_normal(400), np.arange(400) // 10, 1)
    assert covariance[0, 0] == pytest.approx(PRIOR_STD**2)
    np.testing.assert_allclose(covariance[0, 1:], 0.0, atol=1e-12)


def test_doubt_hardly_widens_what_the_data_tell():
    rows = regression()
    np.testing.assert_allclose(normal_covariance(rows, 2), normal_covariance(rows, 0), rtol=2e-3)


@pytest.mark.parametrize("clustered", [False, True])
def test_a_coefficient_in_another_unit_has_its_error_in_that_unit(clustered):
    random = np.random.default_rng(1)
    rows, residuals, clusters = regression(), random.standard_normal(400), np.arange(400) // 10
    units = np.array([1e6, 1e-6])

    def covariance(design: np.ndarray) -> np.ndarray:
        return clustered_covariance(design, residuals, clusters, 0) if clustered else normal_covariance(design, 0)

    np.testing.assert_allclose(covariance(rows * units), covariance(rows) / np.outer(units, units), rtol=1e-9)


def test_neither_the_order_of_samples_nor_the_numbers_of_clusters_matter():
    random = np.random.default_rng(2)
    rows, residuals, clusters = regression(), random.standard_normal(400), np.arange(400) // 10
    order = random.permutation(400)
    np.testing.assert_allclose(
        clustered_covariance(rows[order], residuals[order], 1000 - 7 * clusters[order], 0),
        clustered_covariance(rows, residuals, clusters, 0),
        rtol=1e-9,
    )


def test_intervals_hold_with_independent_noise():
    random = np.random.default_rng(3)
    rows = regression()
    noises = list(random.standard_normal((2000, 400)))
    assert np.all(np.abs(coverage(rows, noises, None) - 0.95) < 0.02)
    assert np.all(np.abs(coverage(rows, noises[:500], np.arange(400) // 4) - 0.95) < 0.03)


def test_intervals_hold_where_whole_strokes_are_shifted_and_those_of_independent_blocks_do_not():
    random = np.random.default_rng(4)
    rows, strokes = regression(), np.arange(400) // 8
    noises = [random.standard_normal(50)[strokes] + 0.2 * random.standard_normal(400) for _ in range(500)]
    assert np.all(np.abs(coverage(rows, noises, strokes) - 0.95) < 0.04)
    assert np.all(coverage(rows, noises, None) < 0.7)


def test_too_few_strokes_count_as_none():
    rows = regression()
    np.testing.assert_array_equal(
        clustered_covariance(rows, np.ones(400), np.arange(400) // 134, 0), normal_covariance(rows, 0)
    )


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_correlation_time_of_a_first_order_process(memory):
    random = np.random.default_rng(5)
    values = np.zeros(40_000)
    for i, kick in enumerate(random.standard_normal(len(values) - 1), start=1):
        values[i] = memory * values[i - 1] + kick
    everything = np.ones(len(values), dtype=bool)
    expected = (1.0 + memory) / (1.0 - memory)
    assert correlation_time(values, everything) == pytest.approx(expected, rel=0.1)
    assert correlation_time(1e3 * values + 5.0, everything) == pytest.approx(correlation_time(values, everything))
    assert correlation_time(values[::-1], everything) == pytest.approx(correlation_time(values, everything))
    gaps = random.random(len(values)) < 0.7
    assert correlation_time(np.where(gaps, values, 1e6), gaps) == pytest.approx(expected, rel=0.15)


def test_correlation_time_of_nothing_is_one():
    assert correlation_time(np.zeros(50), np.ones(50, dtype=bool)) == 1.0
    assert correlation_time(np.ones(50), np.zeros(50, dtype=bool)) == 1.0
