"""Huber loss of whitened residuals, quadratic in the range of noise and linear beyond, and Gauss-Newton steps on it."""

import math

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules

CLIP = 5.0 * rules.HUBER
"""Whitened residual at which a regression on a signal and a spectrum clip."""


def loss(e: Array) -> Array:
    """Return the loss of each whitened residual: a negative log-likelihood up to a constant [nats]."""
    size = np.abs(e)
    return np.where(size <= rules.HUBER, 0.5 * e * e, rules.HUBER * size - 0.5 * rules.HUBER**2)


def weights(e: Array) -> Array:
    """Return the weights for which a quadratic loss has the gradient of the Huber loss."""
    return np.minimum(1.0, rules.HUBER / np.maximum(np.abs(e), 1e-12))


def power(e: Array) -> float:
    """Return the mean square of values, such as whitened residuals."""
    return float(np.mean(e * e))


def rms(values: Array) -> float:
    """Return the root mean square of values."""
    return math.sqrt(power(values))


def closed(before: Array, after: Array, noise: Array) -> float:
    """Return the fraction of the error power beyond noise that was removed, from whitened residuals."""
    return (power(before) - power(after)) / max(power(before) - power(noise), 1e-300)


def inflation(e: Array) -> float:
    """Return the ratio of the variance of whitened residuals to that of noise, at least 1."""
    return max(1.0, float(np.mean(np.minimum(e * e, rules.MAX_SQUARE))))


def gauss_newton(jacobian: Array, e: Array, damping: float, values: Array, lower: Array, upper: Array) -> Array:
    """Return a damped Gauss-Newton step that keeps parameters at a bound from leaving it.

    Args:
        jacobian: derivatives of the whitened residuals, shape (n, p).
        e: whitened residuals, shape (n,).
        damping: Levenberg's, relative to the scaled normal matrix.
        values: current parameters, shape (p,).
        lower: lower bounds, shape (p,).
        upper: upper bounds, shape (p,).

    Returns:
        The step, shape (p,); zero where the derivatives are not finite.
    """
    free = np.ones(len(values), dtype=np.bool_)
    step = np.zeros(len(values))
    w = weights(e)
    for _ in range(len(values)):
        j = jacobian[:, free]
        normal, gradient = products(j, w, e)
        if not (np.all(np.isfinite(normal)) and np.all(np.isfinite(gradient))):
            return np.zeros(len(values))
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(scale, scale) + damping * np.eye(len(scale))
        step[:] = 0.0
        step[free] = -np.linalg.lstsq(scaled, gradient / scale, rcond=1e-12)[0] / scale
        # A parameter at a bound that would leave its range is fixed there, and the others are solved for again.
        out = free & (((values + step < lower) & (values <= lower)) | ((values + step > upper) & (values >= upper)))
        if not np.any(out):
            break
        free &= ~out
        step[out] = 0.0
        if not np.any(free):
            break
    return step


def products(j: Array, w: Array, e: Array) -> tuple[Array, Array]:
    """Return jᵀ w j and jᵀ w e; for such thin matrices einsum is faster than a threaded matrix library."""
    return np.einsum("ni,n,nj->ij", j, w, j), np.einsum("ni,n,n->i", j, w, e)


def linear_loss(e: Array, jacobian: Array, step: Array) -> float:
    """Return the loss after a step if the whitened residuals are linear in the parameters [nats]."""
    return float(np.sum(loss(e + jacobian @ step)))
