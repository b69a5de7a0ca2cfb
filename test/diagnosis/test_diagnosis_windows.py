"""Windows: derivatives by parts, their noise, their number."""

import numpy as np
import pytest

from ehls_ros.diagnosis.rules import RELEVANT
from ehls_ros.diagnosis.windows import smooth_window

PERIOD = 1e-3


@pytest.mark.parametrize("samples", [8, 40, 41])
def test_derivatives_by_parts_are_exact_for_parabolas(samples):
    w = smooth_window(samples, PERIOD)
    t = PERIOD * np.arange(200)
    middle = t[w.starts(len(t))] + 0.5 * samples * PERIOD
    x = 3.0 - 2.0 * t + 5.0 * t**2
    assert w.mean(np.ones_like(t)) == pytest.approx(1.0, abs=1e-12)
    # An error here enters every balance: it has to stay well below the level of relevance.
    np.testing.assert_allclose(w.rate(x), -2.0 + 10.0 * middle, rtol=RELEVANT)
    np.testing.assert_allclose(w.acceleration(x), 10.0, rtol=RELEVANT)


def test_derivatives_by_parts_are_those_of_the_window_mean():
    w = smooth_window(40, PERIOD)
    t = PERIOD * np.arange(1000)
    for frequency in (0.5, 5.0, 15.0):
        rate = 2.0 * np.pi * frequency
        # The derivative of the mean is the mean of the derivative: no error of differences, which would be (rate T)^2 / 24.
        np.testing.assert_allclose(w.rate(np.sin(rate * t)), w.mean(rate * np.cos(rate * t)), atol=2e-5 * rate)
        np.testing.assert_allclose(w.acceleration(np.sin(rate * t)), w.mean(-(rate**2) * np.sin(rate * t)), atol=5e-4 * rate**2)


def test_noise_of_a_window_is_that_of_its_weights():
    w = smooth_window(40, PERIOD, hop=1)
    noise = np.random.default_rng(0).standard_normal(400_000)
    assert np.std(w.mean(noise)) == pytest.approx(np.linalg.norm(w.weights), rel=0.05)
    assert np.std(w.rate(noise)) == pytest.approx(np.linalg.norm(w.slopes), rel=0.05)
    assert np.std(w.acceleration(noise)) == pytest.approx(np.linalg.norm(w.curvatures), rel=0.05)


def test_a_signal_shorter_than_a_window_has_no_windows():
    w = smooth_window(40, PERIOD)
    assert w.starts(40).size == w.mean(np.zeros(40)).size == 0
    assert w.starts(41).size == w.mean(np.zeros(41)).size == 1
    assert w.starts(500).size == w.mean(np.zeros(500)).size
