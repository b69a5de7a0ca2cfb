"""Decimation of a series to the samples that a figure can show."""

import numpy as np
from numpy.typing import NDArray

BUCKETS = 4000
"""Number of intervals to which a long series is reduced: about three per pixel, which leaves detail for zooming."""


def kept_samples(values: NDArray[np.float64], buckets: int = BUCKETS) -> NDArray[np.intp]:
    """Select the samples that draw the same line as the complete series.

    A series of up to three samples per bucket is kept complete. Of a longer one, the lowest and the highest sample of every
    bucket are kept, so that no peak is lost. One missing sample is kept in each bucket of which half or more is missing, so
    that gaps remain. Shorter gaps are bridged: a break at every missed cycle would leave little of the line. Samples within a
    run of equal values are dropped.

    Args:
        values: one signal, shape (n,), with NaN where a sample is missing.
        buckets: number of intervals of equal length.

    Returns:
        Indices to keep, increasing, at most three per bucket.
    """
    count = len(values)
    kept = np.arange(count) if count <= 3 * buckets else _extremes(values, -(-count // buckets))
    shown = values[kept]
    same = (shown[1:] == shown[:-1]) | ~(np.isfinite(shown[1:]) | np.isfinite(shown[:-1]))
    draws = np.ones(len(kept), dtype=bool)
    draws[1:-1] = ~(same[1:] & same[:-1])
    return kept[draws]


def _extremes(values: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    count = len(values)
    padded = np.full(-(-count // size) * size, np.nan)
    padded[:count] = values
    parts = padded.reshape(-1, size)
    known = np.isfinite(parts)
    start = np.arange(len(parts)) * size
    lowest = start + np.where(known, parts, np.inf).argmin(axis=1)
    highest = start + np.where(known, parts, -np.inf).argmax(axis=1)
    gap = (start + known.argmin(axis=1))[known.mean(axis=1) <= 0.5]
    kept = np.unique(np.concatenate([[0, count - 1], lowest, highest, gap]))
    return kept[kept < count]


def part_means(values: NDArray[np.float64], parts: int) -> NDArray[np.float64]:
    """Average over consecutive intervals of equal length.

    Args:
        values: shape (n,); the mean of an interval with NaN is NaN.
        parts: number of intervals, at most n.

    Returns:
        The mean of each interval, shape (parts,).
    """
    starts = np.arange(parts) * len(values) // parts
    means: NDArray[np.float64] = np.add.reduceat(values, starts) / np.diff(starts, append=len(values))
    return means
