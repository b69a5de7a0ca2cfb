"""What can be told of a sampled signal by itself: its noise, its outliers, its resolution."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ehls_ros.arrays import Array

NEIGHBOURS, SIDE = 11, 5
"""Samples around a sample, and on either side of it, that it is compared with to tell whether it is an outlier."""

OUTLIER = 6.0
"""Standard deviations from its neighbours at which a sample is an outlier."""

GAUSS = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""

KEPT, KEPT_VARIANCE = 0.98, 0.874
"""Part of the differences that tell a noise, and the part of a normal distribution's variance that they have."""

Mask = NDArray[np.bool_]


def filled(values: Array) -> Array:
    """Return the signal with straight lines where it is not finite; there must be a finite sample."""
    finite = np.isfinite(values)
    return np.where(finite, values, np.interp(np.arange(len(values)), np.flatnonzero(finite), values[finite]))


def inliers(values: Array) -> Mask:
    """Tell which samples are finite and agree with their neighbours, or where the signal moves fast with those of one side."""
    finite = np.isfinite(values)
    whole = filled(values)
    off = np.abs(whole - median_filter(whole, NEIGHBOURS, mode="nearest"))
    steps = np.abs(np.diff(whole))
    usual = max(GAUSS * float(np.median(off)), float(np.median(steps)), 1e-12 * float(np.max(np.abs(whole))))
    # Where a signal hardly moves against its resolution, the median says nothing: look at what is not zero.
    moved = off[off > 0.0]
    if moved.size:
        usual = max(usual, float(np.quantile(moved, 0.25)))
    smooth = median_filter(whole, SIDE, mode="nearest")
    before, after = _sides(smooth)
    beside = np.minimum(np.abs(whole - before), np.abs(whole - after))
    nearby = np.maximum(*_sides(median_filter(np.abs(np.diff(smooth, prepend=smooth[:1])), SIDE, mode="nearest")))
    good: Mask = finite & ((off <= OUTLIER * usual) | (beside <= OUTLIER * np.maximum(usual, nearby)))
    return good


def _sides(medians: Array) -> tuple[Array, Array]:
    """Return, of medians over :data:`SIDE` samples, those just before and just after each sample."""
    wide = np.pad(medians, SIDE // 2 + 1, mode="edge")
    return wide[: len(medians)], wide[-len(medians) :]


def noise(values: Array) -> float:
    """Return the standard deviation of white noise from third differences, which a smooth signal has none of.

    A quantised signal that stands still has no differences at all, so the mean counts, with the largest left out.
    """
    differences = np.abs(np.diff(values, 3))
    if not differences.size:
        return 0.0
    kept = differences[differences <= np.quantile(differences, KEPT)]
    return float(np.sqrt(np.mean(kept**2) / (20.0 * KEPT_VARIANCE)))
