"""Block of band-limited noise as in the reference `random`, faded in and out about its mean; one period is a load cycle."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.control.programme.blocks.base import Course
from ehls_ros.control.references import random as reference
from ehls_ros.control.references._signals import faded
from ehls_ros.errors import BadInput
from ehls_ros.schema import quantity

PER_PERIOD = 40
"""Samples per period of the highest frequency that resolve every turning point."""


class Parameters(NamedTuple):
    """Size, band, and the number of periods."""

    rms: Annotated[float, quantity("N or m", "root of the mean square about the mean", minimum=0.0, maximum=1e6)]
    lowest_frequency: Annotated[float, quantity("Hz", "lower end of the band", above=0.0, maximum=1e3)]
    highest_frequency: Annotated[float, quantity("Hz", "upper end of the band", above=0.0, maximum=1e3)]
    mean: Annotated[float, quantity("N or m", "mean value", minimum=-1e6, maximum=1e6)] = 0.0
    period: Annotated[float, quantity("s", "time after which the noise repeats", above=0.0, maximum=1e4)] = 20.0
    count: Annotated[int, quantity("1", "number of periods", minimum=1, maximum=10**12)] = 1  # type: ignore[assignment]  # a tuple has a method of this name
    seed: Annotated[int, quantity("1", "seed of the phases", minimum=0, maximum=2**32 - 1)] = 1
    fade: Annotated[
        float, quantity("s", "time in which the noise grows, and again in which it dies", above=0.0, maximum=1e4)
    ] = 0.5


def _noise(p: Parameters) -> reference.Parameters:
    return reference.Parameters(p.rms, p.lowest_frequency, p.highest_frequency, p.period, p.seed, p.mean)


def course(p: Parameters, start: float) -> Course:
    """Return the course of the noise.

    Raises:
        BadInput: the two fades take longer than the block.
    """
    duration = p.count * p.period
    if 2.0 * p.fade > duration:
        raise BadInput(f"fade is {p.fade:g} s", "random", f"at most half of count periods, {0.5 * duration:g} s")
    return Course(p.mean, p.mean, duration, p.period, p.count, 1.0 / (PER_PERIOD * p.highest_frequency))


def sample(t: Array, p: Parameters, start: float) -> Array:
    """Return the noise and its derivatives."""
    return faded(reference.steady(t, _noise(p)), t, p.mean, p.count * p.period, p.fade)
