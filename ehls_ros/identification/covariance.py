"""Covariance of a least-squares fit whose residuals are correlated."""

import math

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.samples import Mask

PRIOR_STD = 2.0
"""Standard deviation of a searched coordinate without any data; for a logarithm, a factor of e^2.

It prevents coordinates on which the data have no bearing from degrading the others.
"""

MAX_LAGS = 200
"""Longest lag of the residuals' autocorrelation [blocks]."""


def normal_covariance(rows: Array, searched: int) -> Array:
    """Return the covariance of least squares with independent residuals of standard deviation 1.

    Args:
        rows: derivatives of the residuals, shape (n, coefficients).
        searched: number of leading coefficients that are searched coordinates, with a prior standard deviation of
            :data:`PRIOR_STD`.

    Returns:
        Array of shape (coefficients, coefficients).
    """
    return _inverse(rows.T @ rows + _prior(rows.shape[1], searched))


def clustered_covariance(rows: Array, residuals: Array, clusters: Array, searched: int) -> Array:
    """Return the cluster-robust covariance, valid for any correlation of the residuals within a cluster.

    A model error shifts a whole stroke to one side, so strokes, not blocks, are independent. The jackknife covariance follows
    from the shifts of the coefficients when each cluster in turn is left out (CR3 of Cameron and Miller, Journal of Human
    Resources 50, 2015), widened for the degrees of freedom. It remains valid if only a few clusters determine a coefficient.

    Args:
        rows: derivatives of the residuals, shape (n, coefficients).
        residuals: residuals in standard deviations, shape (n,).
        clusters: number of the cluster of each residual, shape (n,).
        searched: as in :func:`normal_covariance`.

    Returns:
        Array of shape (coefficients, coefficients); that of :func:`normal_covariance` if there are fewer than two clusters for
        each coefficient.
    """
    prior = _prior(rows.shape[1], searched)
    information = rows.T @ rows + prior
    order = np.argsort(clusters, kind="stable")
    starts = np.flatnonzero(np.diff(clusters[order], prepend=np.nan) != 0.0)
    count, size = len(starts), rows.shape[1]
    if count < 2 * size:
        return _inverse(information)
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = rows[order] / scale
    pulls = np.add.reduceat(scaled * residuals[order, np.newaxis], starts)
    ends = np.append(starts[1:], len(order))
    own = np.array([scaled[i:j].T @ scaled[i:j] for i, j in zip(starts.tolist(), ends.tolist(), strict=True)])
    without = information / scale[:, np.newaxis] / scale - own
    shifts = (np.linalg.pinv(without, rcond=1e-13, hermitian=True) @ pulls[:, :, np.newaxis])[:, :, 0] / scale
    jackknife: Array = shifts.T @ shifts * (count / (count - size))
    independent = _inverse(information)
    return jackknife + independent @ prior @ independent


def _prior(size: int, searched: int) -> Array:
    """Return the prior information matrix."""
    return np.diag(np.where(np.arange(size) < searched, 1.0 / PRIOR_STD**2, 0.0))


def _inverse(information: Array) -> Array:
    """Return the inverse of an information matrix whose coefficients have different units."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / scale[:, np.newaxis] / scale, rcond=1e-13, hermitian=True)
    covariance: Array = inverse / scale[:, np.newaxis] / scale
    return covariance


def correlation_time(residuals: Array, mask: Mask) -> float:
    """Return the number of successive residuals that carry the information of one, at least 1.

    Args:
        residuals: residuals in the order of time, shape (n,).
        mask: mask of the residuals that count, shape (n,).
    """
    values = np.where(mask, residuals, 0.0)
    values = values - np.sum(values) / max(1, int(mask.sum())) * mask
    pairs = _autocorrelation(mask.astype(np.float64))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = _autocorrelation(values) / np.where(pairs > 0.5, pairs, np.nan)
        correlation = np.nan_to_num(correlation / correlation[0])
    insignificant = np.flatnonzero(correlation < 2.0 / math.sqrt(max(1, int(mask.sum()))))
    last = int(insignificant[0]) if insignificant.size else len(correlation)
    return float(max(1.0, 1.0 + 2.0 * np.sum(correlation[1:last])))


def _autocorrelation(values: Array) -> Array:
    """Return the sums of products of values up to :data:`MAX_LAGS` apart."""
    size = 1 << (2 * len(values) - 1).bit_length()
    spectrum = np.fft.rfft(values, size)
    products: Array = np.fft.irfft(spectrum * np.conj(spectrum), size)[:MAX_LAGS]
    return products
