"""Random noise within a band: harmonics of equal size and seeded random phase, which repeat after a period."""

from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references._signals import harmonics, quintic, weighted
from ehls_ros.control.references.base import place_of
from ehls_ros.errors import BadInput
from ehls_ros.schema import quantity

FADE = 0.5
"""Duration of the fade-in from the mean to full size [s]."""

MAX_HARMONICS = 4096
"""Most harmonics, as each is computed for every sample."""


class Parameters(NamedTuple):
    """Size, band, and the period of repetition."""

    rms: Annotated[float, quantity("N or m", "root of the mean square about the mean", minimum=0.0, maximum=1e6)] = 2e3
    lowest_frequency: Annotated[float, quantity("Hz", "lower end of the band", above=0.0, maximum=1e3)] = 0.2
    highest_frequency: Annotated[float, quantity("Hz", "upper end of the band", above=0.0, maximum=1e3)] = 5.0
    period: Annotated[float, quantity("s", "time after which the signal repeats", above=0.0, maximum=1e4)] = 20.0
    seed: Annotated[int, quantity("1", "seed of the phases", minimum=0, maximum=2**32 - 1)] = 1
    offset: Annotated[float, quantity("N or m", "mean value", minimum=-1e6, maximum=1e6)] = 0.0


@lru_cache(maxsize=8)
def _components(p: Parameters) -> tuple[Array, Array]:
    """Return frequencies [Hz] and phases [rad]; cached, as they are needed for every block of cycles."""
    first, last = int(np.ceil(p.lowest_frequency * p.period - 1e-9)), int(p.highest_frequency * p.period + 1e-9)
    if last < first:
        what = f"no multiple of 1/period = {1.0 / p.period:g} Hz is in the band"
        raise BadInput(what, "random", "highest_frequency above lowest_frequency by 1/period, or a longer period")
    if last - first >= MAX_HARMONICS:
        raise BadInput(f"the band has {last - first + 1} harmonics", "random", f"at most {MAX_HARMONICS}: a shorter period")
    frequency = np.arange(first, last + 1) / p.period
    return frequency, np.random.default_rng(p.seed).uniform(0.0, 2.0 * np.pi, frequency.size)


def steady(t: Array, p: Parameters) -> Array:
    """Return the periodic signal without fade-in, with its derivatives, shape (n, 3).

    Args:
        t: times, shape (n,) [s].
        p: parameters.

    Raises:
        BadInput: the band has no harmonic, or too many.
    """
    frequency, phase = _components(p)
    rows = harmonics(t, np.full(frequency.size, p.rms * np.sqrt(2.0 / frequency.size)), frequency, phase)
    rows[:, 0] += p.offset
    return rows


def sample(t: Array, p: Parameters) -> Array:
    """Return the signal and its derivatives.

    Raises:
        BadInput: the band has no harmonic, or too many.
    """
    wave = steady(t, p)
    wave[:, 0] -= p.offset
    rows = weighted(quintic(t, FADE), wave)
    rows[:, 0] += p.offset
    return rows


def place(t: Array, p: Parameters) -> Array:
    """Return block and periods completed, shape (n, 2)."""
    return place_of(t, 1.0 / p.period)
