"""Uncertainty of a mean over cycles, and its components.

Source: JCGM 100 (GUM): type A from repeated observations, type B from other information, combined as the root of the sum of
squares, expanded by k = 2. The scatter of few cycles is enlarged by Student's factor, so that k = 2 means 95 % for them too.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array

COVERAGE = 2.0
"""Coverage factor k of every expanded uncertainty."""


class Uncertainty(NamedTuple):
    """Standard uncertainties of one quantity, in its unit.

    Attributes:
        repeatability: type A, from the scatter over the cycles; NaN for a single cycle.
        fit: type A, from the covariance of the least squares fit.
        noise: type B, from the sensor's noise in the rig file; like ``fit`` another estimate of ``repeatability``.
        resolution: type B, from the sensor's resolution in the rig file.
        cell: type B, from the load cell's calibration.
        waveform: type B, from the deviation of the fitted harmonics from the waveform at the quantity.
    """

    repeatability: float
    fit: float
    noise: float = 0.0
    resolution: float = 0.0
    cell: float = 0.0
    waveform: float = 0.0

    @property
    def random(self) -> float:
        """The part that decreases with more cycles: the largest of three estimates of it."""
        return float(np.nanmax([self.repeatability, self.fit, self.noise, 0.0]))

    @property
    def standard(self) -> float:
        """Combined standard uncertainty."""
        return math.hypot(self.random, self.resolution, self.cell, self.waveform)

    @property
    def expanded(self) -> float:
        """Expanded uncertainty, k = 2."""
        return COVERAGE * self.standard


class TypeB(NamedTuple):
    """Prior information on the force sensor.

    Attributes:
        noise: standard deviation of one sample [N].
        resolution: standard uncertainty of the resolution [N].
        cell: standard uncertainty of the calibration, as a fraction of the reading.
    """

    noise: float = 0.0
    resolution: float = 0.0
    cell: float = 0.0


def std_of_resolution(step: float) -> float:
    """Return the standard uncertainty of a quantised reading: a rectangular distribution of the step's width."""
    return step / math.sqrt(12.0)


def std_of_mean(values: Array | NDArray[np.complex128], freedom_per_cycle: int = 1) -> float:
    """Return the standard uncertainty of the mean of independent cycles; NaN for a single one.

    Args:
        values: values of the cycles, shape (n,), real or complex; only their deviations matter. For complex values the result
            is that of each component.
        freedom_per_cycle: 2 for complex values.
    """
    cycles = len(values)
    if cycles < 2:
        return math.nan
    freedom = freedom_per_cycle * (cycles - 1)
    variance = float(np.sum(np.abs(values - np.mean(values)) ** 2)) / freedom
    return student(freedom) * math.sqrt(variance / cycles)


def student(freedom: int) -> float:
    """Return the factor by which k = 2 has the same coverage for few degrees of freedom as for many."""
    return float(scipy.stats.t.ppf(scipy.stats.norm.cdf(COVERAGE), freedom)) / COVERAGE
