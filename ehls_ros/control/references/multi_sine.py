"""Simultaneous sines, spread over a band with Schroeder's phases, which keep the peak low."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references._signals import harmonics
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Harmonics of one base frequency with equal amplitudes."""

    amplitude: Annotated[float, quantity("N or m", "amplitude of each sine", minimum=-1e6, maximum=1e6)] = 1e3
    base_frequency: Annotated[float, quantity("Hz", "lowest frequency; the others are multiples", above=0.0, maximum=1e3)] = 0.1
    harmonics: Annotated[int, quantity("1", "number of sines", minimum=1, maximum=1000)] = 10
    offset: Annotated[float, quantity("N or m", "mean value", minimum=-1e6, maximum=1e6)] = 0.0


def sample(t: Array, p: Parameters) -> Array:
    """Return the sum and its derivatives."""
    number = np.arange(1, p.harmonics + 1, dtype=np.float64)
    phase = -np.pi * number * (number - 1) / p.harmonics
    out = harmonics(t, np.full(p.harmonics, p.amplitude), p.base_frequency * number, phase)
    out[:, 0] += p.offset
    return out
