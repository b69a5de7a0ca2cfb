"""Rates of change of the coefficients: lines through the last readings of those that drift rather than jump."""

import math
from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.remembered import Past

MOST_HISTORY = 1440
"""Maximum number of readings kept for a process or a report of one day."""

RATES = 60
"""Number of last readings from which the rates of change are estimated."""

FEWEST_RATES = 5
"""Minimum number of these readings."""

FEWEST = 4
"""Minimum number of readings to detect a jump."""

HOUR = 3600.0


def rates(history: Sequence[Past]) -> dict[str, Estimate]:
    """Return the change per hour of each drifting coefficient.

    Args:
        history: the readings, oldest first.
    """
    out = dict[str, Estimate]()
    told = dict[str, list[tuple[float, float, float]]]()
    units = dict[str, str]()
    for past in history[-RATES:]:
        for reading in past.readings:
            if reading.told:
                told.setdefault(reading.name, []).append((past.time / HOUR, reading.value, reading.deviation))
                units[reading.name] = reading.unit
    for name, points in told.items():
        hours, values, deviations = np.array(points).T
        if len(points) < FEWEST_RATES or np.ptp(hours) <= 0.0 or jumped(hours, values, deviations):
            continue
        weights = 1.0 / deviations**2
        slope, rest = _line(hours, values, weights)
        spread = float(np.sum(weights * (hours - np.average(hours, weights=weights)) ** 2))
        grown = max(1.0, rest / (len(points) - 2))
        out[name] = Estimate(slope, math.sqrt(grown / spread), f"{units[name]}/h")
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
    if count < FEWEST:
        return False
    weights = 1.0 / deviations**2

    def rest(part: slice) -> float:
        return float(np.sum(weights[part] * (values[part] - np.average(values[part], weights=weights[part])) ** 2))

    jump = min(rest(slice(None, place)) + rest(slice(place, None)) for place in range(1, count))
    _, line = _line(times, values, weights)
    # A scatter below the readings' errors is not informative. The free position of the jump counts as two parameters.
    return count * math.log(max(jump / count, 1.0)) + 3.0 * math.log(count) < count * math.log(max(line / count, 1.0))


def _line(times: Array, values: Array, weights: Array) -> tuple[float, float]:
    """Return the slope of the weighted least-squares line, and its residual sum of squares."""
    along = times - np.average(times, weights=weights)
    slope = float(np.sum(weights * along * values) / np.sum(weights * along**2))
    level = values - slope * along
    return slope, float(np.sum(weights * (level - np.average(level, weights=weights)) ** 2))
