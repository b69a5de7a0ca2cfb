import numpy as np
import pytest

from ehls_ros.report.decimation import kept_samples, part_means

BUCKETS = 100


@pytest.fixture
def long_noise():
    return np.random.default_rng(3).standard_normal(54_321)


def test_a_short_series_is_kept_whole():
    values = np.random.default_rng(0).standard_normal(3 * BUCKETS)
    assert kept_samples(values, BUCKETS).tolist() == list(range(len(values)))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_series_of_hardly_any_samples(count):
    assert kept_samples(np.arange(float(count)), BUCKETS).tolist() == list(range(count))


def test_the_extremes_of_every_bucket_survive(long_noise):
    kept = kept_samples(long_noise, BUCKETS)
    size = -(-len(long_noise) // BUCKETS)
    for start in range(0, len(long_noise), size):
        part = long_noise[start : start + size]
        shown = long_noise[kept[(kept >= start) & (kept < start + size)]]
        assert (shown.min(), shown.max()) == (part.min(), part.max())


@pytest.mark.parametrize("at", [0, 1, 777, 30_000, 54_320])
@pytest.mark.parametrize("height", [-50.0, 50.0])
def test_a_single_peak_survives(long_noise, at, height):
    long_noise[at] = height
    assert at in kept_samples(long_noise, BUCKETS)


def test_few_samples_in_order_with_both_ends(long_noise):
    long_noise[::7] = np.nan
    kept = kept_samples(long_noise, BUCKETS)
    assert len(kept) <= 3 * BUCKETS + 2
    assert np.all(np.diff(kept) > 0)
    assert (kept[0], kept[-1]) == (0, len(long_noise) - 1)


@pytest.mark.parametrize("start", range(20_000, 20_600, 83))
def test_a_gap_of_a_bucket_stays_a_gap(long_noise, start):
    size = -(-len(long_noise) // BUCKETS)
    long_noise[start : start + size] = np.nan
    kept = kept_samples(long_noise, BUCKETS)
    inside = kept[(kept >= start) & (kept < start + size)]
    assert inside.size > 0
    assert np.isnan(long_noise[inside]).all()


def test_single_missing_samples_do_not_break_the_line(long_noise):
    long_noise[5::400] = np.nan
    assert np.isfinite(long_noise[kept_samples(long_noise, BUCKETS)]).all()


def test_a_constant_needs_its_ends_only():
    assert kept_samples(np.full(150, 7.0), BUCKETS).tolist() == [0, 149]


def test_a_step_keeps_both_sides():
    values = np.repeat([0.0, 1.0], 60)
    assert kept_samples(values, BUCKETS).tolist() == [0, 59, 60, 119]


def test_part_means():
    assert part_means(np.arange(7.0), 3).tolist() == pytest.approx([0.5, 2.5, 5.0])
    assert np.isnan(part_means(np.array([1.0, np.nan, 3.0]), 3)).tolist() == [False, True, False]
