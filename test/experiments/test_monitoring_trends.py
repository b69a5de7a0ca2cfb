"""Trends of coefficients: a drift has a rate, a jump has none; and the time at which a limit is reached."""

import math
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.diagnosis.monitoring.tracking import PastReadings, Reading
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.monitoring.trends import check_limits, jumped, predict_limit, predict_limits, rates
from ehls_ros.experiments.spec import load_rig

NAME = "leakage_coefficient"
HEALTHY = 4.0
NOISE = 0.02
HOURS = np.arange(20.0)


@pytest.fixture(scope="module")
def rig():
    return load_rig(configured(Path("rig_paper_measured")))


def reading(value, deviation=0.01, why_not=""):
    return Reading(NAME, value, math.inf if why_not else deviation, "1", why_not)


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


def test_an_exact_line_reaches_its_limit_where_it_crosses_it():
    found = predict_limit(reading(6.0, 1e-9), Estimate(0.5, 1e-9, "1/h"), 10.0, HEALTHY)
    assert (found.hours, found.earliest, found.latest) == pytest.approx((8.0, 8.0, 8.0), rel=1e-6)


def test_the_interval_holds_the_true_time_in_95_of_100_cases():
    rng, hits, count = np.random.default_rng(1), 0, 4000
    for value, rate in zip(rng.normal(6.0, 0.5, count), rng.normal(0.5, 0.1, count), strict=True):
        found = predict_limit(reading(value, 0.5), Estimate(rate, 0.1, "1/h"), 10.0, HEALTHY)
        # If the rate may be zero, the interval has no end.
        hits += bool(found.why_not) or found.earliest <= 8.0 <= found.latest
    assert hits / count == pytest.approx(0.95, abs=0.01)


def test_a_limit_below_the_healthy_value_is_a_lower_one():
    falls = predict_limit(reading(3.0), Estimate(-0.5, 0.01, "1/h"), 2.0, HEALTHY)
    assert falls.hours == pytest.approx(2.0)
    assert falls.earliest < 2.0 < falls.latest
    assert predict_limit(reading(1.9), Estimate(-0.5, 0.01, "1/h"), 2.0, HEALTHY).hours == 0.0


@pytest.mark.parametrize(
    ("now", "rate", "why_not"),
    [
        (reading(6.0, why_not="not excited by the programme"), Estimate(0.5, 0.01, "1/h"), "not excited"),
        (reading(6.0), None, "too few"),
        (reading(6.0), Estimate(0.5, 0.3, "1/h"), "not significantly"),
        (reading(6.0), Estimate(-0.5, 0.01, "1/h"), "departs"),
    ],
)
def test_no_time_is_told_that_the_data_do_not_tell(now, rate, why_not):
    found = predict_limit(now, rate, 10.0, HEALTHY)
    assert why_not in found.why_not
    assert math.isnan(found.hours)


def test_a_coefficient_that_has_no_reading_says_so(rig):
    assert "not tracked" in predict_limits((), {}, {NAME: 1e-11}, rig)[NAME].why_not


@pytest.mark.parametrize(("limits", "said"), [({"leakage": 1.0}, "leakage_coefficient"), ({NAME: math.nan}, "above or below")])
def test_a_limit_that_no_coefficient_has_is_refused(limits, said, rig):
    with pytest.raises(BadInput, match=said):
        check_limits(limits, rig, "--limit")
