"""The activity of the external force: known in closed form for a sine; the friction is uncertain after a reversal."""

import math

import numpy as np
import pytest

from ehls_ros.control import process_noise
from ehls_ros.control.process_noise import DIRECTION, MEAN_SQUARE, TRAVEL, ProcessNoise

NOISE = ProcessNoise(min_noise=1e6, rate_noise=300.0, time_constant=0.5, reversal_factor=3.0, reversal_travel=2e-3)
external_noise = process_noise.external_noise.py_func


def settled(rate: float, velocity: float = 0.1) -> np.ndarray:
    """Return an activity long after the last reversal, with a rate of the external force of this rms [N/s]."""
    state = np.zeros(process_noise.SIZE)
    state[MEAN_SQUARE], state[DIRECTION], state[TRAVEL] = rate**2, math.copysign(1.0, velocity), 1.0
    return state


def test_a_force_at_rest_has_the_least_noise():
    state = settled(0.0)
    assert [external_noise(0.0, 0.1, 1e-3, NOISE, state) for _ in range(5)] == [1e6] * 5


def test_a_steady_rate_counts_by_its_share_of_the_memory():
    state = settled(0.0)
    for _ in range(500):
        noise = external_noise(2e4, 0.1, 1e-3, NOISE, state)
    # A quarter at once, then 0.499 s of a first-order lag of 0.5 s.
    share = 1.0 - 0.75 * math.exp(-0.499 / 0.5)
    assert state[MEAN_SQUARE] == pytest.approx(4e8 * share, rel=1e-9)
    assert noise == pytest.approx(math.hypot(1e6, 300.0 * 2e4 * math.sqrt(share)), rel=1e-9)


def test_a_rate_far_beyond_the_usual_counts_at_once():
    state = settled(1e3)
    assert external_noise(1e5, 0.1, 1e-3, NOISE, state) == pytest.approx(math.hypot(1e6, 300.0 * 5e4), rel=1e-9)


def test_a_quick_sine_counts_by_its_rms():
    state = settled(0.0)
    angles = 2.0 * math.pi * 40.0 * 1e-3 * np.arange(4000)
    noises = [external_noise(3e4 * math.sin(angle), 0.1, 1e-3, NOISE, state) for angle in angles]
    assert np.mean(noises[-1000:]) == pytest.approx(math.hypot(1e6, 300.0 * 3e4 / math.sqrt(2.0)), rel=0.01)


def test_what_is_remembered_does_not_depend_on_the_period():
    coarse, fine = settled(1e4), settled(1e4)
    external_noise(1.5e4, 0.1, 2e-3, NOISE, coarse)
    for _ in range(2):
        external_noise(1.5e4, 0.1, 1e-3, NOISE, fine)
    assert fine == pytest.approx(coarse, rel=1e-12)


def test_after_a_reversal_the_friction_is_in_doubt_until_the_piston_has_travelled():
    state = settled(0.0)
    # 20 cycles of 0.1 mm: the last but one ends 1.9 mm after the reversal.
    noises = [external_noise(0.0, -0.1, 1e-3, NOISE, state) for _ in range(25)]
    doubtful = sum(noise == 3e6 for noise in noises)
    assert doubtful in (19, 20)
    assert noises == [3e6] * doubtful + [1e6] * (25 - doubtful)
    # The way back is counted from zero.
    assert external_noise(0.0, 0.1, 1e-3, NOISE, state) == 3e6
