"""A sine whose frequency changes linearly and is then held."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """offset + amplitude sin(phase), where the phase rate goes from start to end frequency."""

    amplitude: Annotated[float, quantity("N or m", "amplitude", minimum=-1e6, maximum=1e6)] = 5e3
    start_frequency: Annotated[float, quantity("Hz", "frequency at t = 0", minimum=0.0, maximum=1e3)] = 0.1
    end_frequency: Annotated[float, quantity("Hz", "frequency at the end of the sweep", minimum=0.0, maximum=1e3)] = 5.0
    sweep: Annotated[float, quantity("s", "duration of the sweep", above=0.0, maximum=1e6)] = 10.0
    offset: Annotated[float, quantity("N or m", "mean value", minimum=-1e6, maximum=1e6)] = 0.0


def sample(t: Array, p: Parameters) -> Array:
    """Return the chirp and its derivatives."""
    slope = 2.0 * np.pi * (p.end_frequency - p.start_frequency) / p.sweep
    swept = np.clip(t, 0.0, p.sweep)
    omega = 2.0 * np.pi * p.start_frequency + slope * swept
    omega_rate = np.where(t < p.sweep, slope, 0.0)
    angle = 2.0 * np.pi * p.start_frequency * swept + 0.5 * slope * swept**2 + omega * (t - swept)
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.column_stack(
        [
            p.offset + p.amplitude * sine,
            p.amplitude * omega * cosine,
            p.amplitude * (omega_rate * cosine - omega**2 * sine),
        ]
    )
