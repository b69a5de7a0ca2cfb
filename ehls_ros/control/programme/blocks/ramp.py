"""Block with a ramp from the programme's present value to another value."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.control.references import ramp as reference
from ehls_ros.errors import BadInput
from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Final value, and either the duration or the largest rate."""

    to: Annotated[float, quantity("N or m", "value at the end", minimum=-1e6, maximum=1e6)]
    time: Annotated[float | None, quantity("s", "time that the ramp takes", above=0.0, maximum=1e6)] = None
    rate: Annotated[float | None, quantity("N/s or m/s", "largest rate, in place of the time", above=0.0, maximum=1e9)] = None
    rounding: Annotated[
        float,
        quantity("1", "share of the time in which the rate rises, and again in which it falls", minimum=0.01, maximum=0.5),
    ] = 0.2


def course(p: Parameters, start: float) -> Course:
    """Return the course of the ramp.

    Raises:
        BadInput: time and rate are both given, or neither is.
    """
    if (p.time is None) == (p.rate is None):
        raise BadInput(f"time is {p.time}, rate is {p.rate}", "ramp", "one of the two")
    return Course(start, p.to, _time(p, start), 0.0, 0, 0.1 * _time(p, start))


MIN_TIME = 1e-3
"""Duration of a ramp by rate between equal values [s]."""


def _time(p: Parameters, start: float) -> float:
    if p.time is not None or p.rate is None:
        return p.time or MIN_TIME
    return max(MIN_TIME, abs(p.to - start) / (p.rate * (1.0 - p.rounding)))


def sample(t: Array, p: Parameters, start: float) -> Array:
    """Return the ramp and its derivatives."""
    return reference.sample(t, reference.Parameters(start, p.to, _time(p, start), p.rounding))
