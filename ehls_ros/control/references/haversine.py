"""Cosine pulses from a valley to a peak and back, with or without a dwell at the valley between them."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references.base import place_of
from ehls_ros.schema import quantity

VALLEY = 0.0
"""Phase of the valley within a load cycle [1]."""


class Parameters(NamedTuple):
    """offset - amplitude cos(2 pi x / pulse) during the pulse, x being the phase; then offset - amplitude."""

    amplitude: Annotated[float, quantity("N or m", "half of the pulse's height", minimum=-1e6, maximum=1e6)] = 5e3
    frequency: Annotated[float, quantity("Hz", "frequency of the pulses", above=0.0, maximum=1e3)] = 0.5
    offset: Annotated[float, quantity("N or m", "mean of valley and peak", minimum=-1e6, maximum=1e6)] = 5e3
    pulse: Annotated[
        float, quantity("1", "share of the period that the pulse takes; the rest of it is a rest", minimum=0.01, maximum=1.0)
    ] = 1.0


def sample(t: Array, p: Parameters) -> Array:
    """Return the pulses and their derivatives."""
    phase = t * p.frequency
    phase = phase - np.floor(phase)
    omega = 2.0 * np.pi * p.frequency / p.pulse
    angle = np.where(phase < p.pulse, 2.0 * np.pi * phase / p.pulse, 0.0)
    sine, cosine = np.sin(angle), np.cos(angle)
    bend = np.where(phase < p.pulse, p.amplitude * omega**2 * cosine, 0.0)
    return np.column_stack([p.offset - p.amplitude * cosine, p.amplitude * omega * sine, bend])


def place(t: Array, p: Parameters) -> Array:
    """Return block and load cycles completed, shape (n, 2)."""
    return place_of(t, p.frequency)
