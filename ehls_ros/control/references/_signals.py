"""Signals shared by references: transition between two values, weighted signal, and sum of sines."""

from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array


def quintic(since: Array, duration: float) -> tuple[Array, Array, Array]:
    """Return the quintic from rest at 0 to rest at 1, held before and after, with its derivatives.

    Args:
        since: times since its start, shape (n,) [s].
        duration: duration [s].

    Returns:
        Value [1], first [1/s] and second derivative [1/s^2], shape (n,) each.
    """
    x = np.clip(since / duration, 0.0, 1.0)
    left = 1.0 - x
    value = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return value, 30.0 * (x * left) ** 2 / duration, 60.0 * x * left * (1.0 - 2.0 * x) / duration**2


def weighted(weight: tuple[Array, Array, Array], rows: Array) -> Array:
    """Return a signal times a weight.

    Args:
        weight: weight with its two derivatives, shape (n,) each, as of :func:`quintic`.
        rows: signal with its two derivatives, shape (n, 3).

    Returns:
        The product with its two derivatives, shape (n, 3).
    """
    value, rate, bend = weight
    signal, slope, curvature = rows.T
    return np.column_stack(
        [value * signal, rate * signal + value * slope, bend * signal + 2.0 * rate * slope + value * curvature]
    )


def faded(rows: Array, t: Array, rest: float, duration: float, fade: float) -> Array:
    """Return a signal faded in from rest and out to rest.

    Args:
        rows: signal with its two derivatives, shape (n, 3).
        t: times since the beginning, shape (n,) [s].
        rest: value at the beginning and at the end.
        duration: time until the end [s].
        fade: time of each of the two fades [s].

    Returns:
        The faded signal with its two derivatives, shape (n, 3).
    """
    up, up_rate, up_bend = quintic(t, fade)
    down, down_rate, down_bend = quintic(duration - t, fade)
    weight = (up * down, up_rate * down - up * down_rate, up_bend * down - 2.0 * up_rate * down_rate + up * down_bend)
    about_rest = rows.copy()
    about_rest[:, 0] -= rest
    out = weighted(weight, about_rest)
    out[:, 0] += rest
    return out


def eased_in(row: Sequence[float], start: float, since: float, duration: float) -> list[float]:
    """Return a reference's row, led in from rest at a value without a jump up to the second derivative.

    Args:
        row: value of the reference, first and second derivative.
        start: initial value, in the reference's unit.
        since: time since the beginning [s].
        duration: duration of the lead-in [s].
    """
    weight, rate, bend = (float(part[0]) for part in quintic(np.array([since]), duration))
    apart, speed, acceleration = row[0] - start, row[1], row[2]
    return [
        start + weight * apart,
        weight * speed + rate * apart,
        weight * acceleration + 2.0 * rate * speed + bend * apart,
    ]


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
