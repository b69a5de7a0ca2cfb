"""Huber loss of whitened residuals: quadratic in the range of noise, linear beyond."""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules


def loss(e: Array) -> Array:
    """Return the loss of each whitened residual: a negative log-likelihood up to a constant [nats]."""
    size = np.abs(e)
    return np.where(size <= rules.HUBER, 0.5 * e * e, rules.HUBER * size - 0.5 * rules.HUBER**2)


def weights(e: Array) -> Array:
    """Return the weights for which a quadratic loss has the gradient of the Huber loss."""
    return np.minimum(1.0, rules.HUBER / np.maximum(np.abs(e), 1e-12))


def power(e: Array) -> float:
    """Return the mean square of whitened residuals."""
    return float(np.mean(e * e))


def closed(before: Array, after: Array, noise: Array) -> float:
    """Return the fraction of the error power beyond noise that was removed, from whitened residuals."""
    return (power(before) - power(after)) / max(power(before) - power(noise), 1e-300)


def inflation(e: Array) -> float:
    """Return the ratio of the variance of whitened residuals to that of noise, at least 1."""
    return max(1.0, float(np.mean(np.minimum(e * e, rules.MOST_SQUARE))))
