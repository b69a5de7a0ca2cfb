"""An irregular smooth signal: sines of seeded random frequency and phase, faded in from zero."""

from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.references._signals import harmonics, quintic, weighted
from ehls_ros.errors import BadInput
from ehls_ros.schema import quantity

FADE = 0.5
"""Duration of the fade-in from zero to full size [s]."""


class Parameters(NamedTuple):
    """Size and band; the paper draws such a signal but does not define it."""

    amplitude: Annotated[float, quantity("N or m", "largest value the sum of sines can reach", minimum=-1e6, maximum=1e6)] = 1e4
    lowest_frequency: Annotated[float, quantity("Hz", "lower end of the band", above=0.0, maximum=1e3)] = 0.1
    highest_frequency: Annotated[float, quantity("Hz", "upper end of the band", above=0.0, maximum=1e3)] = 0.8
    components: Annotated[int, quantity("1", "number of sines", minimum=1, maximum=1000)] = 6
    seed: Annotated[int, quantity("1", "seed of frequencies and phases", minimum=0, maximum=2**32 - 1)] = 1


def sample(t: Array, p: Parameters) -> Array:
    """Return the signal and its derivatives.

    Raises:
        BadInput: the lower end of the band is above the upper end.
    """
    if p.lowest_frequency > p.highest_frequency:
        what = f"lowest_frequency is {p.lowest_frequency:g}"
        raise BadInput(what, "irregular", f"at most highest_frequency = {p.highest_frequency:g} Hz")
    random = np.random.default_rng(p.seed)
    frequency = np.sort(random.uniform(p.lowest_frequency, p.highest_frequency, p.components))
    phase = random.uniform(0.0, 2.0 * np.pi, p.components)
    weight = 1.0 / frequency
    wave = harmonics(t, p.amplitude * weight / weight.sum(), frequency, phase)
    # A quintic step: value, first and second derivative start at zero and end at those of the wave.
    return weighted(quintic(t, FADE), wave)
