"""Prediction of the time at which a drifting coefficient reaches its limit."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, Reading
from ehls_ros.errors import BadInput, one_of
from ehls_ros.estimate import Estimate
from ehls_ros.physics.rig import Rig

NORMAL_95 = 1.959964
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""


class Reach(NamedTuple):
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


def reach(reading: Reading, rate: Estimate | None, limit: float, healthy: float) -> Reach:
    """Predict the time at which a coefficient reaches its limit at its present rate.

    The time is a ratio of two normal variables, distance and rate. Its interval is Fieller's (Journal of the Royal Statistical
    Society B 16, 1954), which is finite only if the rate is significantly different from zero.

    Args:
        reading: current reading of the coefficient.
        rate: its change per hour; None if unknown.
        limit: its limit, in its unit.
        healthy: its value on the healthy rig: a limit above is an upper one, a limit below a lower one.
    """
    if not reading.told:
        return Reach(limit, why_not=reading.why_not)
    way = math.copysign(1.0, limit - healthy)
    distance = way * (limit - reading.value)
    if distance <= 0.0:
        return Reach(limit, 0.0, 0.0, 0.0)
    if rate is None:
        return Reach(limit, why_not="too few readings tell its rate, or it jumped")
    speed = way * rate.value
    if abs(speed) <= NORMAL_95 * rate.std:
        return Reach(limit, why_not="its rate may be zero")
    if speed <= 0.0:
        return Reach(limit, why_not="it moves away from its limit")
    # Roots t of (distance - t speed)^2 = z^2 (deviation^2 + t^2 std^2).
    square, product = speed**2 - (NORMAL_95 * rate.std) ** 2, distance * speed
    rest = distance**2 - (NORMAL_95 * reading.deviation) ** 2
    root = math.sqrt(max(product**2 - square * rest, 0.0))
    return Reach(limit, distance / speed, max((product - root) / square, 0.0), (product + root) / square)


def reaches(
    readings: Sequence[Reading], rates: Mapping[str, Estimate], limits: Mapping[str, float], rig: Rig
) -> dict[str, Reach]:
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
            found[name] = reach(by_name[name], rates.get(name), limit, COEFFICIENTS[name].given(rig))
        else:
            found[name] = Reach(limit, why_not="it is not tracked on this rig")
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
