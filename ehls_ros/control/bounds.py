"""What the paper proves of the law: bounds (44)-(46) of error and time, re-derived.

All quantities in the paper's units: MPa, mm, t, s, N; ``g`` in 1/MPa, ``k`` and ``b/h`` in MPa/s.
"""

import math

from ehls_ros.arrays import kernel


@kernel
def pressure_error_bound_kernel(k: float, g: float, h: float, b: float) -> float:
    """Return the bound (44), infinite where the surface is not steep enough to hold |s| = b/h."""
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
        Bound of |e3| [MPa]; infinite when k h <= 2 b, where no error can balance |s| = b/h.
    """
    bound: float = pressure_error_bound_kernel.py_func(k, g, h, b)
    return bound


def force_error_bound(k: float, g: float, h: float, b: float, piston_area: float) -> float:
    """Return the bound (44) as a force [N]; ``piston_area`` in m^2."""
    return pressure_error_bound(k, g, h, b) * piston_area * 1e6


def reaching_rate(h: float, b: float, xi: float, e1: float, delta_f: float, moving_mass: float) -> float:
    """Return the rate (h + h xi e1 delta_f / b)/m0 at which the robust term (35) pulls s in [1/s].

    Args:
        h: gain of the robust term [t/s].
        b: half width of the robust term [t MPa/s^2].
        xi: weight of the error's rate [1].
        e1: 4 Ac beta_e / Vt [MPa/mm].
        delta_f: bound of the disturbance [N].
        moving_mass: m0 [t].
    """
    return (h + h * xi * e1 * delta_f / b) / moving_mass


def reaching_time_bound(s0: float, h: float, b: float, xi: float, e1: float, delta_f: float, moving_mass: float) -> float:
    """Return a bound of the time t0 after which |s| <= b/h, the meaning of (46).

    (46) estimates it with the rate h alone. From m0 s' = -(h + h xi e1 delta_f/b) s + xi e1 fd and
    |fd| <= delta_f follows |s(t)| <= s_inf + (|s0| - s_inf) exp(-K t), solved for b/h here.

    Args:
        s0: sliding variable at the start [MPa/s].
        h: as in :func:`reaching_rate`.
        b: as there.
        xi: as there.
        e1: as there.
        delta_f: as there.
        moving_mass: as there.

    Returns:
        t0 [s]; 0 when the start lies inside, infinite without a robust term.
    """
    if h == 0.0:
        return math.inf
    rate = reaching_rate(h, b, xi, e1, delta_f, moving_mass)
    remains = xi * e1 * delta_f / (moving_mass * rate)
    if abs(s0) <= b / h:
        return 0.0
    return math.log((abs(s0) - remains) / (b / h - remains)) / rate  # (46)


def sliding_time(e3_start: float, e3_end: float, k: float, g: float, xi: float) -> float:
    """Return the time the error takes along the surface s = 0, the second part of (45).

    On it xi e3' = -k/2 tanh(g e3/2), whose integral is (4 xi/(k g)) ln sinh(g e3/2).

    Args:
        e3_start: error where the surface is reached [MPa].
        e3_end: error to come down to, above 0 [MPa].
        k: slope of the surface [MPa/s].
        g: steepness of the surface [1/MPa].
        xi: weight of the error's rate [1].

    Returns:
        Time [s]; 0 when the error is already that small.
    """
    if abs(e3_start) <= abs(e3_end):
        return 0.0

    def log_sinh(x: float) -> float:
        return x + math.log1p(-math.exp(-2.0 * x)) - math.log(2.0)

    return 4.0 * xi / (k * g) * (log_sinh(g * abs(e3_start) / 2.0) - log_sinh(g * abs(e3_end) / 2.0))  # (45)
