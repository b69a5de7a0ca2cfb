"""A ramp from one value to another, linear between rounded ends, so that the second derivative does not jump."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """From start to end within a time; the rate is cubic in time at both ends, and constant in between."""

    start: Annotated[float, quantity("N or m", "value at t = 0", minimum=-1e6, maximum=1e6)] = 0.0
    end: Annotated[float, quantity("N or m", "value at the end of the ramp, and from then on", minimum=-1e6, maximum=1e6)] = 1e4
    time: Annotated[float, quantity("s", "time that the ramp takes", above=0.0, maximum=1e6)] = 1.0
    rounding: Annotated[
        float,
        quantity("1", "share of that time in which the rate rises, and again in which it falls", minimum=0.01, maximum=0.5),
    ] = 0.2


def sample(t: Array, p: Parameters) -> Array:
    """Return the ramp and its derivatives."""
    way, bend = p.end - p.start, p.rounding * p.time
    fastest = way / (p.time - bend)
    since = np.clip(t, 0.0, p.time)
    # The second half mirrors the first one.
    late = since > 0.5 * p.time
    s = np.where(late, p.time - since, since)
    x = np.minimum(s / bend, 1.0)
    gone = fastest * bend * x**3 * (1.0 - 0.5 * x) + fastest * np.maximum(s - bend, 0.0)
    rate = fastest * x**2 * (3.0 - 2.0 * x)
    acceleration = fastest / bend * 6.0 * x * (1.0 - x)
    return np.column_stack([np.where(late, p.end - gone, p.start + gone), rate, np.where(late, -acceleration, acceleration)])
