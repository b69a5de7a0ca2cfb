"""Sums of sines, shared by several references."""

import numpy as np

from ehls_ros.arrays import Array


def harmonics(t: Array, amplitude: Array, frequency: Array, phase: Array) -> Array:
    """Return a sum of sines with its derivatives.

    Args:
        t: times, shape (n,) [s].
        amplitude: amplitudes, shape (m,).
        frequency: frequencies, shape (m,) [Hz].
        phase: phases at t = 0, shape (m,) [rad].

    Returns:
        Value, first and second derivative, shape (n, 3).
    """
    out = np.zeros((t.size, 3))
    for a, f, start in zip(amplitude, frequency, phase, strict=True):
        omega = 2.0 * np.pi * f
        sine, cosine = np.sin(omega * t + start), np.cos(omega * t + start)
        out[:, 0] += a * sine
        out[:, 1] += a * omega * cosine
        out[:, 2] -= a * omega**2 * sine
    return out
