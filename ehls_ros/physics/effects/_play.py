"""Dead zone and play (backlash) operators."""

import math

from ehls_ros.arrays import kernel

ROUNDED_WITHIN = 35.0
"""Distance from a corner, in units of its rounding, beyond which the rounding is negligible."""

FOLLOW_RATE = 5e3
"""Rate at which a state follows its algebraic value [1/s]; integration steps stay below 2.7 / FOLLOW_RATE."""


@kernel
def clamp(value: float, low: float, high: float) -> float:
    """Return the value limited to the bounds."""
    return min(max(value, low), high)


@kernel
def dead_zone(value: float, low: float, high: float) -> float:
    """Return the excess of the value over the bounds, 0 between them."""
    return value - clamp(value, low, high)


@kernel
def ramp(value: float, rounding: float) -> float:
    """Return the positive part of the value, with a rounded corner."""
    if rounding <= 0.0 or abs(value) > ROUNDED_WITHIN * rounding:
        return max(value, 0.0)
    return rounding * math.log1p(math.exp(value / rounding))


@kernel
def play_output(previous: float, driver: float, width: float) -> float:
    """Return the output of a play operator of total width ``width``, from its previous output and its input."""
    return clamp(previous, driver - 0.5 * width, driver + 0.5 * width)
