"""Noise and outliers of a sampled signal."""

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array

NEIGHBOURS, SIDE = 11, 5
"""Width of the windows around a sample and on either side of it, for outlier detection [samples]."""

OUTLIER = 6.0
"""Deviation from the neighbours above which a sample is an outlier, in standard deviations of the signal's noise."""

GAUSS = 1.4826
"""Ratio of standard deviation to median absolute deviation of a normal distribution."""

KEPT, KEPT_VARIANCE = 0.98, 0.874
"""Fraction of the differences, the smallest ones, used to estimate noise; and their fraction of a normal distribution's
variance."""

QUIET, QUIETEST, QUIET_WHITE = 20, 0.2, 0.72
"""Length of a part of a signal that may be quiet [samples]; the quantile taken of the parts' noise; and that quantile for white
noise, as a fraction of its standard deviation."""

BESIDE = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
"""Weights of the two samples on either side of a sample in the cubic through them."""

CUBIC, TOGETHER = 3, 5
"""Degree of the curve through the samples about one, and rounds in which the farthest of them is taken out."""

BENT = 0.1
"""Distance of the neighbours from their curve, relative to that of a lone sample; at a corner it is 0.17, at a gap 0.3."""

RARE = 0.005
"""Fraction up to which lone samples are left out; more of them are noise, or jitter of the sampling."""

Mask = NDArray[np.bool_]


def filled(values: Array) -> Array:
    """Return the signal with non-finite samples interpolated linearly; at least one sample must be finite."""
    finite = np.isfinite(values)
    return np.where(finite, values, np.interp(np.arange(len(values)), np.flatnonzero(finite), values[finite]))


def inliers(values: Array) -> Mask:
    """Return which samples are finite and agree with their neighbours on both sides or, in fast motion, on one side."""
    finite = np.isfinite(values)
    gapless = filled(values)
    off = np.abs(gapless - scipy.ndimage.median_filter(gapless, NEIGHBOURS, mode="nearest"))
    steps = np.abs(np.diff(gapless))
    usual = max(GAUSS * float(np.median(off)), float(np.median(steps)), 1e-12 * float(np.max(np.abs(gapless))))
    # If the signal hardly moves relative to its resolution, the median is zero; use the non-zero deviations.
    moved = off[off > 0.0]
    if moved.size:
        usual = max(usual, float(np.quantile(moved, 0.25)))
    smooth = scipy.ndimage.median_filter(gapless, SIDE, mode="nearest")
    before, after = _sides(smooth)
    one_sided = np.minimum(np.abs(gapless - before), np.abs(gapless - after))
    nearby = np.maximum(*_sides(scipy.ndimage.median_filter(np.abs(np.diff(smooth, prepend=smooth[:1])), SIDE, mode="nearest")))
    alone = _lone(gapless)
    if np.mean(alone) > RARE:
        alone[:] = False
    good: Mask = finite & ~alone & ((off <= OUTLIER * usual) | (one_sided <= OUTLIER * np.maximum(usual, nearby)))
    return good


def _lone(values: Array) -> Mask:
    """Return the samples off the cubic through their neighbours, which are on one curve without them.

    A converter that now and then repeats or skips a sample of a fast motion leaves such ones, as does interference. In steps
    and bends the neighbours are on no curve.
    """
    reach = BESIDE.size // 2
    if len(values) < 2 * BESIDE.size:
        return np.zeros(len(values), dtype=np.bool_)
    off = values - np.convolve(np.pad(values, reach, mode="edge"), BESIDE, mode="valid")
    off[:reach] = off[-reach:] = 0.0
    sizes = np.abs(off)
    if not np.any(sizes > 0.0):
        return sizes > 0.0
    # A sample off the curve of its neighbours puts four of these off theirs.
    far = sizes > OUTLIER * GAUSS * np.maximum(_block_medians(sizes, 4 * NEIGHBOURS), np.median(sizes[sizes > 0.0]))
    out: Mask = far.copy()
    padded = np.pad(off, reach)
    for shift, weight in enumerate(BESIDE):
        if weight != 0.0:
            out &= np.abs(padded[shift : shift + len(off)] + weight * off) <= BENT * sizes
    left = np.flatnonzero(far & ~scipy.ndimage.binary_dilation(out, iterations=reach))
    if len(left) <= NEIGHBOURS * RARE * len(values):
        for middle in left:
            out[_off_curve(values, sizes, int(middle))] = True
    return out


def _off_curve(values: Array, sizes: Array, middle: int) -> NDArray[np.intp]:
    """Return the few samples about one that are off the curve of all others there, and off that of their neighbours.

    None if the others are on no curve, or if two of them follow each other: a short event is no error of the converter.

    Args:
        values: the signal, shape (n,).
        sizes: distance of each sample from the cubic through its neighbours, shape (n,).
        middle: index of the sample.
    """
    index = np.arange(max(middle - NEIGHBOURS, 0), min(middle + NEIGHBOURS + 1, len(values)))
    kept = np.ones(len(index), dtype=np.bool_)
    for _ in range(TOGETHER):
        curve = np.polynomial.Polynomial.fit(index[kept], values[index[kept]], CUBIC)
        off = np.abs(values[index] - curve(index))
        if not np.all(kept) and np.max(off[kept]) <= BENT * np.min(off[~kept]):
            alone = np.all(np.diff(index[~kept]) > 1) and np.all(off[~kept] < 2.0 * sizes[index[~kept]])
            return index[~kept] if alone else index[:0]
        kept[np.argmax(np.where(kept, off, -1.0))] = False
    return index[:0]


def _block_medians(values: Array, length: int) -> Array:
    """Return the median of the block of about a length in which each value lies, shape (n,)."""
    short, longer = divmod(len(values), max(1, len(values) // length))
    parts = np.split(values, [longer * (short + 1)])
    rows = (parts[0].reshape(longer, short + 1), parts[1].reshape(-1, short))
    return np.concatenate([np.repeat(np.median(part, axis=1), part.shape[1]) for part in rows])


def _sides(medians: Array) -> tuple[Array, Array]:
    """Return the medians over the :data:`SIDE` samples just before and just after each sample."""
    wide = np.pad(medians, SIDE // 2 + 1, mode="edge")
    return wide[: len(medians)], wide[-len(medians) :]


def noise_of(third_differences: Array) -> float:
    """Return the standard deviation of white noise from given third differences, including the largest."""
    return float(np.sqrt(np.mean(third_differences**2) / 20.0)) if third_differences.size else 0.0


def noise(values: Array) -> float:
    """Return the standard deviation of white noise from the third differences, which vanish for a smooth signal.

    The mean square without the largest differences is used rather than the median, which is zero for a quantised signal at
    rest.
    """
    differences = np.abs(np.diff(values, 3))
    if not differences.size:
        return 0.0
    kept = differences[differences <= np.quantile(differences, KEPT)]
    return float(np.sqrt(np.mean(kept**2) / (20.0 * KEPT_VARIANCE)))


def noise_between_moves(values: Array) -> float:
    """Return the standard deviation of white noise from the quiet parts of a signal that may move fast between samples.

    Motion that resembles noise adds to it, so the estimate is too high for a signal without quiet parts.
    """
    parts = np.array([noise(part) for part in np.array_split(values, max(1, len(values) // QUIET))])
    moving = parts[parts > 0.0]
    quiet = float(np.quantile(moving, QUIETEST)) / QUIET_WHITE if moving.size else 0.0
    return min(noise(values), quiet)
