"""A triangle wave with parabolic corners, so that the second derivative is bounded."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references.base import place_of
from ehls_ros.schema import quantity

VALLEY = 0.75
"""Phase of the valley within a load cycle [1]."""


class Parameters(NamedTuple):
    """Zero-mean triangle starting upward from zero; the flanks have the slope of the sharp triangle."""

    amplitude: Annotated[float, quantity("N or m", "peak of the sharp triangle", minimum=-1e6, maximum=1e6)] = 1e4
    frequency: Annotated[float, quantity("Hz", "frequency", above=0.0, maximum=1e3)] = 0.5
    corner: Annotated[
        float, quantity("1", "fraction of the period that each corner's parabola takes", above=0.0, maximum=0.5)
    ] = 0.02


def sample(t: Array, p: Parameters) -> Array:
    """Return the rounded triangle and its derivatives."""
    period = 1.0 / p.frequency
    slope = 4.0 * p.amplitude / period
    half = 0.5 * p.corner * period
    # Time from the nearest corner; corners are at a quarter period and every half period after it.
    half_periods = np.floor((t + 0.25 * period) / (0.5 * period))
    after = t + 0.25 * period - half_periods * 0.5 * period
    rising = np.where(half_periods % 2 == 0, 1.0, -1.0)
    from_middle = after - 0.25 * period
    value = rising * slope * from_middle
    rate = rising * slope
    acceleration = np.zeros_like(t)
    distance = np.abs(from_middle) - (0.25 * period - half)
    round_off = distance > 0.0
    towards = np.sign(from_middle)
    value = value - np.where(round_off, rising * towards * slope * distance**2 / (2.0 * half), 0.0)
    rate = rate * np.where(round_off, 1.0 - distance / half, 1.0)
    acceleration = np.where(round_off, -rising * towards * slope / half, 0.0)
    return np.column_stack([value, rate, acceleration])


def place(t: Array, p: Parameters) -> Array:
    """Return block and load cycles completed, shape (n, 2); NaN without a frequency."""
    return place_of(t, p.frequency)
