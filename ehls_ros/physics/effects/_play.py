"""Play and clearance, as several effects have them."""

import math

from ehls_ros.arrays import kernel

STRAIGHT = 35.0
"""Roundings beyond a corner from which on it is as good as sharp."""

RATE = 5e3
"""How fast a state is drawn to where it has to be [1/s]; integration steps stay below 2.7 / RATE."""


@kernel
def clamp(value: float, low: float, high: float) -> float:
    """Return the value, or the bound it lies beyond."""
    return min(max(value, low), high)


@kernel
def dead_zone(value: float, low: float, high: float) -> float:
    """Return what of the value lies beyond the bounds."""
    return value - clamp(value, low, high)


@kernel
def ramp(value: float, rounding: float) -> float:
    """Return what of the value is positive, its corner rounded over a length."""
    if rounding <= 0.0 or abs(value) > STRAIGHT * rounding:
        return max(value, 0.0)
    return rounding * math.log1p(math.exp(value / rounding))


@kernel
def dragged(place: float, driver: float, width: float) -> float:
    """Return where a part that lay at ``place`` lies now: a clearance of ``width`` in all takes it along with its driver."""
    return clamp(place, driver - 0.5 * width, driver + 0.5 * width)
