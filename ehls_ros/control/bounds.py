"""Theoretical bounds (44)-(46) of error and time, re-derived from the paper.

All quantities are in the paper's units: MPa, mm, t, s, N; ``g`` in 1/MPa, ``k`` and ``b/h`` in MPa/s.
"""

import math

import numpy as np

from ehls_ros.arrays import in_python, kernel


@kernel
def pressure_error_bound_kernel(k: float, g: float, h: float, b: float) -> float:
    """Return the bound (44), infinite if the surface is too flat to balance |s| = b/h."""
    inside = 1.0 - 4.0 * b / (k * h + 2.0 * b)  # (44)
    return -math.log(inside) / g if inside > 0.0 else math.inf


def pressure_error_bound(k: float, g: float, h: float, b: float) -> float:
    """Return the bound (44) of the load pressure error once |s| <= b/h.

    Args:
        k: slope of the surface [MPa/s].
        g: steepness of the surface [1/MPa].
        h: gain of the robust term [t/s].
        b: half width of the robust term [t MPa/s^2].

    Returns:
        Bound of |e3| [MPa]; infinite if k h <= 2 b, when no error can balance |s| = b/h.
    """
    bound: float = in_python(pressure_error_bound_kernel)(k, g, h, b)
    return bound


def force_error_bound(k: float, g: float, h: float, b: float, piston_area: float) -> float:
    """Return the bound (44) as a force [N]; ``piston_area`` in m^2."""
    return pressure_error_bound(k, g, h, b) * piston_area * 1e6


def reaching_rate(h: float, b: float, xi: float, e1: float, delta_f: float, moving_mass: float) -> float:
    """Return the rate (h + h xi e1 delta_f / b)/m0 at which the robust term (35) drives s towards zero [1/s].

    Args:
        h: gain of the robust term [t/s].
        b: half-width of the robust term [t MPa/s^2].
        xi: weight of the error's rate [1].
        e1: 4 Ac beta_e / Vt [MPa/mm].
        delta_f: bound of the disturbance [N].
        moving_mass: m0 [t].
    """
    return (h + h * xi * e1 * delta_f / b) / moving_mass


def reaching_time_bound(s0: float, h: float, b: float, xi: float, e1: float, delta_f: float, moving_mass: float) -> float:
    """Return a bound of the time t0 after which |s| <= b/h, as meant by (46).

    (46) estimates it from the rate h alone. From m0 s' = -(h + h xi e1 delta_f/b) s + xi e1 fd and |fd| <= delta_f follows
    |s(t)| <= s_inf + (|s0| - s_inf) exp(-K t), which is solved here for b/h.

    Args:
        s0: sliding variable at the start [MPa/s].
        h: as in :func:`reaching_rate`.
        b: as in :func:`reaching_rate`.
        xi: as in :func:`reaching_rate`.
        e1: as in :func:`reaching_rate`.
        delta_f: as in :func:`reaching_rate`.
        moving_mass: as in :func:`reaching_rate`.

    Returns:
        t0 [s]; 0 if the start lies inside, infinite without a robust term.
    """
    if h == 0.0:
        return math.inf
    rate = reaching_rate(h, b, xi, e1, delta_f, moving_mass)
    remains = remaining_s(h, b, xi, e1, delta_f, moving_mass)
    if abs(s0) <= b / h:
        return 0.0
    return math.log((abs(s0) - remains) / (b / h - remains)) / rate  # (46)


def remaining_s(h: float, b: float, xi: float, e1: float, delta_f: float, moving_mass: float) -> float:
    """Return the smallest guaranteed |s| under a disturbance of delta_f, slightly below b/h [MPa/s].

    The arguments are those of :func:`reaching_rate`; h must be above 0.
    """
    return xi * e1 * delta_f / (moving_mass * reaching_rate(h, b, xi, e1, delta_f, moving_mass))


def sliding_time(e3_start: float, e3_end: float, k: float, g: float, xi: float, s: float = 0.0) -> float:
    """Return the decay time of the error once the surface is reached, the second part of (45).

    On the surface xi e3' = -k/2 tanh(g e3/2) + s. (45) takes s = 0, as if the surface were reached exactly; with the largest
    remaining s, the time is a bound for any disturbance.

    Args:
        e3_start: error when the surface is reached [MPa].
        e3_end: final error, above 0 [MPa].
        k: slope of the surface [MPa/s].
        g: steepness of the surface [1/MPa].
        xi: weight of the error's rate [1].
        s: sliding variable that opposes the decay of the error, 0 or more [MPa/s].

    Returns:
        Time [s]; 0 if the error is already that small, infinite if s keeps it larger.
    """
    if abs(e3_start) <= abs(e3_end):
        return 0.0
    slope = 0.5 * k
    if slope * math.tanh(0.5 * g * abs(e3_end)) <= s:
        return math.inf

    def primitive(e3: float) -> float:
        # Of 1/((1 - w^2)(slope w - s)) over w = tanh(g e3/2), in partial fractions; 1 - w = 2/(exp(g e3) + 1).
        w = math.tanh(0.5 * g * e3)
        from_one = math.log(2.0) - float(np.logaddexp(g * e3, 0.0))
        poles = -from_one / (2.0 * (slope - s)) - math.log1p(w) / (2.0 * (slope + s))
        return poles + slope / (slope**2 - s**2) * math.log(slope * w - s)

    return 2.0 * xi / g * (primitive(abs(e3_start)) - primitive(abs(e3_end)))  # (45)
