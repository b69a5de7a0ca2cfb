"""Noise that lasts over many windows is found in realisations of it; noise of each window is none."""

import numpy as np
import pytest

from ehls_ros.diagnosis.memory import LENGTH, remembered

COUNT, REALISATIONS = 2000, 8
STEP = 0.013
TIMES = STEP * np.arange(COUNT)


def white(seed):
    """Return realisations of noise that is independent in all windows but the two that overlap with each."""
    fresh = np.random.default_rng(seed).standard_normal((REALISATIONS, COUNT + 2))
    return (fresh[:, :-2] + fresh[:, 1:-1] + fresh[:, 2:]) / np.sqrt(3.0)


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_each_window_does_not_last(seed):
    assert sum(np.count_nonzero(one) for one in remembered(list(white(seed)), TIMES)) < 0.02 * COUNT


def test_an_error_that_lasts_has_its_windows_and_its_size():
    rng = np.random.default_rng(7)
    added = white(8)
    spans = ((300, 400), (900, 1100))
    for begin, end in spans:
        added[:, begin:end] += 3.0 * rng.standard_normal((REALISATIONS, 1))
    found = [one for one in remembered(list(added), TIMES) if np.count_nonzero(one) > LENGTH]
    assert len(found) == len(spans)
    for one, (begin, end) in zip(found, spans, strict=True):
        inside = np.flatnonzero(one)
        assert abs(inside[0] - begin) <= LENGTH
        assert abs(inside[-1] - end) <= LENGTH
        # Of eight realisations.
        assert np.median(one[begin + 20 : end - 20]) == pytest.approx(3.0, rel=0.5)


def test_a_pause_separates_errors():
    added = white(9)
    added[:, 300:500] += 3.0 * np.random.default_rng(10).standard_normal((REALISATIONS, 1))
    times = TIMES + np.where(np.arange(COUNT) >= 400, 100.0, 0.0)
    found = [one for one in remembered(list(added), times) if np.count_nonzero(one) > LENGTH]
    assert [np.count_nonzero(one[:400]) > 0 for one in found] == [True, False]


def test_few_windows_tell_of_no_memory():
    assert remembered([np.ones(10)] * REALISATIONS, TIMES[:10]) == []
    assert remembered([], TIMES) == []
