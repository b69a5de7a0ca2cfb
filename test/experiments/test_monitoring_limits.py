"""Time at which a drifting coefficient reaches its limit."""

import math
from pathlib import Path

import numpy as np
import pytest

from ehls_ros.diagnosis.monitoring.tracking import Reading
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.monitoring.trends import check_limits, predict_limit, predict_limits
from ehls_ros.experiments.spec import load_rig

NAME = "leakage_coefficient"
HEALTHY = 4.0


@pytest.fixture(scope="module")
def rig():
    return load_rig(configured(Path("rig_paper_measured")))


def reading(value, deviation=0.01, why_not=""):
    return Reading(NAME, value, math.inf if why_not else deviation, "1", why_not)


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
