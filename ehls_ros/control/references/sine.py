"""A sine wave."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references.base import place_of
from ehls_ros.schema import quantity

VALLEY = 0.75
"""Phase of the valley within a load cycle, for zero ``phase`` [1]."""


class Parameters(NamedTuple):
    """offset + amplitude sin(2 pi frequency t + phase)."""

    amplitude: Annotated[float, quantity("N or m", "amplitude", minimum=-1e6, maximum=1e6)] = 1e4
    frequency: Annotated[float, quantity("Hz", "frequency", minimum=0.0, maximum=1e3)] = 0.5
    offset: Annotated[float, quantity("N or m", "mean value", minimum=-1e6, maximum=1e6)] = 0.0
    phase: Annotated[float, quantity("rad", "phase at t = 0", minimum=-1e3, maximum=1e3)] = 0.0


def sample(t: Array, p: Parameters) -> Array:
    """Return the sine and its derivatives."""
    omega = 2.0 * np.pi * p.frequency
    angle = omega * t + p.phase
    wave = p.amplitude * np.sin(angle)
    return np.column_stack([p.offset + wave, omega * p.amplitude * np.cos(angle), -(omega**2) * wave])


def place(t: Array, p: Parameters) -> Array:
    """Return block and load cycles completed, shape (n, 2); NaN without a frequency."""
    return place_of(t, p.frequency)
