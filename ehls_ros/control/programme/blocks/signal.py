"""Block with any reference for a limited time, such as a chirp; faded in and out about its initial value."""

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.control.references import REFERENCES
from ehls_ros.control.references._signals import faded
from ehls_ros.errors import BadInput
from ehls_ros.schema import parse, quantity, text

STEPS = 20_000
"""Number of samples of the signal for finding its turning points."""


class Parameters(NamedTuple):
    """Reference, duration and fades."""

    reference: Annotated[Mapping[str, Any], text("name and parameters of the reference")]
    time: Annotated[float, quantity("s", "duration", above=0.0, maximum=1e7)]
    fade: Annotated[float, quantity("s", "duration of the fade-in, and of the fade-out", above=0.0, maximum=1e4)] = 0.5


def _signal(t: Array, p: Parameters) -> Array:
    """Return the reference without fades."""
    values = dict(p.reference)
    member = REFERENCES.load(values.pop("name", None), "signal: reference")
    return member.sample(t, parse(member.Parameters, values, f"signal: {p.reference['name']}"))


def course(p: Parameters, start: float) -> Course:
    """Return the course of the signal.

    Raises:
        BadInput: the reference is invalid, or the two fades take longer than the block.
    """
    if 2.0 * p.fade > p.time:
        raise BadInput(f"fade is {p.fade:g} s", "signal", f"at most half of time, {0.5 * p.time:g} s")
    begin = float(_signal(np.zeros(1), p)[0, 0])
    return Course(begin, begin, p.time, 0.0, 0, p.time / STEPS)


def sample(t: Array, p: Parameters, start: float) -> Array:
    """Return the signal and its derivatives."""
    rest = float(_signal(np.zeros(1), p)[0, 0])
    return faded(_signal(t, p), t, rest, p.time, p.fade)
