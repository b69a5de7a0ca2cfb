"""A sine whose amplitude changes smoothly from one value to another and is then held; from zero, it starts at rest."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references._signals import quintic
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """offset + a(t) sin(2 pi frequency t), with a(t) a quintic from start to end amplitude."""

    start_amplitude: Annotated[float, quantity("N or m", "amplitude at t = 0", minimum=-1e6, maximum=1e6)] = 0.0
    end_amplitude: Annotated[float, quantity("N or m", "amplitude from the end of the sweep on", minimum=-1e6, maximum=1e6)] = (
        1e4
    )
    frequency: Annotated[float, quantity("Hz", "frequency", minimum=0.0, maximum=1e3)] = 0.5
    sweep: Annotated[float, quantity("s", "duration of the sweep", above=0.0, maximum=1e6)] = 10.0
    offset: Annotated[float, quantity("N or m", "mean value", minimum=-1e6, maximum=1e6)] = 0.0


def sample(t: Array, p: Parameters) -> Array:
    """Return the sine and its derivatives."""
    growth = p.end_amplitude - p.start_amplitude
    part, part_rate, part_acceleration = quintic(t, p.sweep)
    amplitude, rate, acceleration = p.start_amplitude + growth * part, growth * part_rate, growth * part_acceleration
    omega = 2.0 * np.pi * p.frequency
    sine, cosine = np.sin(omega * t), np.cos(omega * t)
    return np.column_stack(
        [
            p.offset + amplitude * sine,
            rate * sine + amplitude * omega * cosine,
            (acceleration - amplitude * omega**2) * sine + 2.0 * rate * omega * cosine,
        ]
    )
