"""Rates of change: a drift has one, with its interval; a jump has none."""

import math

import numpy as np
import pytest

from ehls_ros.diagnosis.monitoring.tracking import PastReadings, Reading
from ehls_ros.experiments.monitoring.trends import jumped, rates

NAME = "leakage_coefficient"
NOISE = 0.02
HOURS = np.arange(20.0)


def history(values):
    told = [Reading(NAME, value, NOISE, "1") for value in values]
    return [PastReadings(3600.0 * hour, (reading,)) for hour, reading in zip(HOURS, told, strict=False)]


def test_a_jump_has_no_rate_and_a_drift_has():
    noise = np.random.default_rng(2).normal(0.0, NOISE, (3, 20))
    deviations = np.full(20, NOISE)
    stepped, drifted, steady = 4.0 + np.array([HOURS >= 8.0, 0.1 * HOURS, 0.0 * HOURS]) + noise
    assert jumped(HOURS, stepped, deviations)
    assert not jumped(HOURS, drifted, deviations)
    assert not jumped(HOURS, steady, deviations)
    assert rates(history(stepped)) == {}
    found = rates(history(drifted))[NAME]
    assert found.unit == "1/h"
    assert abs(found.value - 0.1) < 4.0 * found.std


def test_the_interval_of_a_rate_is_that_of_the_line_through_independent_readings():
    """Var(slope) = sigma^2 / sum (t - mean t)^2."""
    rng = np.random.default_rng(3)
    exact = NOISE / math.sqrt(float(np.sum((HOURS - np.mean(HOURS)) ** 2)))
    slopes = [rates(history(4.0 + rng.normal(0.0, NOISE, 20)))[NAME] for _ in range(300)]
    assert float(np.std([s.value for s in slopes])) == pytest.approx(exact, rel=0.15)
    assert float(np.median([s.std for s in slopes])) == pytest.approx(exact, rel=0.15)


def test_few_readings_have_no_rate():
    assert rates(history([4.0, 4.1, 4.2])) == {}
