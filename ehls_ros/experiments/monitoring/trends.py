"""Trends of the coefficients: rates of change, and the time at which a limit is reached."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, PastReadings, Reading
from ehls_ros.errors import BadInput, one_of
from ehls_ros.estimate import Estimate
from ehls_ros.physics.rig import Rig

MAX_HISTORY = 1440
"""Maximum number of readings kept in memory, and shown in a report of one day."""

RATE_READINGS = 60
"""Number of last readings from which the rates of change are estimated."""

MIN_RATE_READINGS = 5
"""Minimum number of these readings."""

MIN_JUMP_READINGS = 4
"""Minimum number of readings to detect a jump."""

HOUR = 3600.0

NORMAL_95 = 1.959964
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""


class LimitPrediction(NamedTuple):
    """Predicted time to a limit.

    Attributes:
        limit: the limit, in the coefficient's unit.
        hours: most likely time until then [h]; 0 if already reached, NaN if not determined.
        earliest, latest: 95 % interval of that time [h].
        why_not: reason if not determined; otherwise empty.
    """

    limit: float
    hours: float = math.nan
    earliest: float = math.nan
    latest: float = math.nan
    why_not: str = ""


def rates(history: Sequence[PastReadings]) -> dict[str, Estimate]:
    """Return the change per hour of each drifting coefficient.

    Args:
        history: the readings, oldest first.
    """
    out = dict[str, Estimate]()
    points_of = dict[str, list[tuple[float, float, float]]]()
    units = dict[str, str]()
    for past in history[-RATE_READINGS:]:
        for reading in past.readings:
            if reading.identified:
                points_of.setdefault(reading.name, []).append((past.time / HOUR, reading.value, reading.deviation))
                units[reading.name] = reading.unit
    for name, points in points_of.items():
        hours, values, deviations = np.array(points).T
        if len(points) < MIN_RATE_READINGS or np.ptp(hours) <= 0.0 or jumped(hours, values, deviations):
            continue
        weights = 1.0 / deviations**2
        slope, residual = _line(hours, values, weights)
        spread = float(np.sum(weights * (hours - np.average(hours, weights=weights)) ** 2))
        excess = max(1.0, residual / (len(points) - 2))
        out[name] = Estimate(slope, math.sqrt(excess / spread), f"{units[name]}/h")
    return out


def jumped(times: Array, values: Array, deviations: Array) -> bool:
    """Return whether readings are better described by one jump, which has no rate, than by a line.

    The two are compared by the Bayesian information criterion, with the scatter around each.

    Args:
        times: times of the readings, increasing, shape (n,).
        values: values, shape (n,).
        deviations: their standard errors, shape (n,).
    """
    count = len(values)
    if count < MIN_JUMP_READINGS:
        return False
    weights = 1.0 / deviations**2

    def residual(part: slice) -> float:
        return float(np.sum(weights[part] * (values[part] - np.average(values[part], weights=weights[part])) ** 2))

    jump = min(residual(slice(None, place)) + residual(slice(place, None)) for place in range(1, count))
    _, line = _line(times, values, weights)
    # A scatter below the readings' errors is not informative. The free position of the jump counts as two parameters.
    return count * math.log(max(jump / count, 1.0)) + 3.0 * math.log(count) < count * math.log(max(line / count, 1.0))


def _line(times: Array, values: Array, weights: Array) -> tuple[float, float]:
    """Return the slope of the weighted least-squares line, and its residual sum of squares."""
    along = times - np.average(times, weights=weights)
    slope = float(np.sum(weights * along * values) / np.sum(weights * along**2))
    level = values - slope * along
    return slope, float(np.sum(weights * (level - np.average(level, weights=weights)) ** 2))


def predict_limit(reading: Reading, rate: Estimate | None, limit: float, healthy: float) -> LimitPrediction:
    """Predict the time at which a coefficient reaches its limit at its present rate.

    The time is a ratio of two normal variables, distance and rate. Its interval is Fieller's (Journal of the Royal Statistical
    Society B 16, 1954), which is finite only if the rate is significantly different from zero.

    Args:
        reading: current reading of the coefficient.
        rate: its change per hour; None if unknown.
        limit: its limit, in its unit.
        healthy: its value on the healthy rig: a limit above is an upper one, a limit below a lower one.
    """
    if not reading.identified:
        return LimitPrediction(limit, why_not=reading.why_not)
    way = math.copysign(1.0, limit - healthy)
    distance = way * (limit - reading.value)
    if distance <= 0.0:
        return LimitPrediction(limit, 0.0, 0.0, 0.0)
    if rate is None:
        return LimitPrediction(limit, why_not="too few readings for a rate, or a jump")
    speed = way * rate.value
    if abs(speed) <= NORMAL_95 * rate.std:
        return LimitPrediction(limit, why_not="the rate is not significantly different from zero")
    if speed <= 0.0:
        return LimitPrediction(limit, why_not="it departs from the limit")
    # Roots t of (distance - t speed)^2 = z^2 (deviation^2 + t^2 std^2).
    square, product = speed**2 - (NORMAL_95 * rate.std) ** 2, distance * speed
    rest = distance**2 - (NORMAL_95 * reading.deviation) ** 2
    root = math.sqrt(max(product**2 - square * rest, 0.0))
    return LimitPrediction(limit, distance / speed, max((product - root) / square, 0.0), (product + root) / square)


def predict_limits(
    readings: Sequence[Reading], rates: Mapping[str, Estimate], limits: Mapping[str, float], rig: Rig
) -> dict[str, LimitPrediction]:
    """Predict the times at which coefficients reach their limits.

    Args:
        readings: current readings of the coefficients.
        rates: changes per hour of those determined.
        limits: the limits by the coefficients' names, each in its unit.
        rig: the healthy rig.
    """
    by_name = {reading.name: reading for reading in readings}
    found = {}
    for name, limit in limits.items():
        if name in by_name:
            found[name] = predict_limit(by_name[name], rates.get(name), limit, COEFFICIENTS[name].given(rig))
        else:
            found[name] = LimitPrediction(limit, why_not="not tracked on this rig")
    return found


def check_limits(limits: Mapping[str, float], rig: Rig, where: str) -> None:
    """Reject invalid limits of coefficients.

    Args:
        limits: limits by the coefficients' names.
        rig: the healthy rig.
        where: their origin, for the error.

    Raises:
        BadInput: a name is unknown, a limit is not a finite number, or it is the healthy rig's value.
    """
    for name, limit in limits.items():
        if name not in COEFFICIENTS:
            raise BadInput(f"coefficient {name!r} is unknown", where, one_of(name, COEFFICIENTS))
        if not math.isfinite(limit) or limit == COEFFICIENTS[name].given(rig):
            expected = f"a number above or below the rig's {COEFFICIENTS[name].given(rig):g}"
            raise BadInput(f"the limit of {name} is {limit:g}", where, expected)
