"""The paper's static objective (20)-(21): steady friction against velocity, as residuals for any optimiser.

The unknowns are coordinates ``x = (Fc, e, w, delta, sigma_f)``, chosen so that the data depend on every coordinate throughout
the box. With (Fc, Fs, Vs, delta, sigma_f), the curves of a quarter of the box would vanish below the slowest speed, and a
search would stall there:

* Fc, from just above 0 to the largest force measured [N];
* e = (Fs - Fc) exp(-(v1/Vs)^delta), the excess of the Stribeck curve over Fc at the slowest speed v1, from 0, so that
  Fs >= Fc, to the largest force [N];
* w, the position of ln Vs between 0, where exp(-5) of the curve remains at v1, and 1, the fastest speed;
* delta, from 0.2 to 4: the literature has 0.5 to 2, and a rig file allows no more than 4;
* sigma_f, from 0 to 1.2 times the largest force over the fastest speed [N s/m].
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.identification.optimisers.base import Problem

LOWEST_EXPONENT, HIGHEST_EXPONENT = 0.2, 4.0

FARTHEST = 5.0
"""Largest (v1/Vs)^delta."""

# Products and sums may be fused, which halves the time; results then differ between machines in the last digit.
_fused = njit(error_model="numpy", forceinline=True, fastmath={"contract"})

_ROUND = 1.5 * 2.0**52  # added to a double, it leaves the nearest integer in the low bits
_LN2_HIGH, _LN2_LOW = 0.693147180369123816490, 1.90821492927058770002e-10


class StaticFriction(NamedTuple):
    """Coefficients identified by the objective.

    Attributes:
        coulomb_force: Fc [N].
        static_force: Fs [N].
        stribeck_velocity: Vs [m/s].
        stribeck_exponent: delta.
        viscous_coefficient: sigma_f [N s/m].
    """

    coulomb_force: float
    static_force: float
    stribeck_velocity: float
    stribeck_exponent: float
    viscous_coefficient: float


class Data(NamedTuple):
    """Steady motions prepared for the kernel, arrays of shape (n,).

    Attributes:
        velocity: velocity [m/s].
        direction: its sign.
        log_speed: logarithm of the speed in m/s.
        force: driving force less its known parts, such as the spring's [N].
        weight: factor of each residual [1/N or 1].
        viscous_damping: B0, one number [N s/m].
        slowest: logarithm of the slowest speed v1 in m/s.
        fastest: logarithm of the fastest one.
    """

    velocity: Array
    direction: Array
    log_speed: Array
    force: Array
    weight: Array
    viscous_damping: float
    slowest: float
    fastest: float


@_fused
def _exp(y: float) -> float:
    """Return e^y, accurate to the last digit or two, in arithmetic that compiles to vector instructions."""
    y = min(max(y, -708.0), 709.0)
    shifted = y * 1.4426950408889634 + _ROUND
    n = shifted - _ROUND
    r = (y - n * _LN2_HIGH) - n * _LN2_LOW  # y = n ln 2 + r, |r| <= ln(2)/2
    p = 1.0 / 479001600.0  # Taylor, to r^12/12!
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    power = np.int64((np.float64(shifted).view(np.int64) + 1023) << 52).view(np.float64)  # 2^n, from its bits
    return p * power


def _log_velocity(w: float, exponent: float, slowest: float, fastest: float) -> float:
    """Return ln Vs."""
    return (1.0 - w) * (slowest - math.log(FARTHEST) / exponent) + w * fastest


_compiled_log_velocity = _fused(_log_velocity)


@_fused
def residuals(x: Array, data: Data, out: Array) -> None:
    """Write w_k (F_k - F^_k) of (21) into ``out``, shape (n,)."""
    coulomb, visible, exponent = x[0], x[1], x[3]
    viscous = data.viscous_damping + x[4]
    log_velocity = _compiled_log_velocity(x[2], exponent, data.slowest, data.fastest)
    first = math.exp(exponent * (data.slowest - log_velocity))  # (v1/Vs)^delta
    for k in range(out.size):
        level = coulomb + visible * _exp(first - _exp(exponent * (data.log_speed[k] - log_velocity)))  # (7)
        out[k] = data.weight[k] * (data.force[k] - viscous * data.velocity[k] - data.direction[k] * level)  # (20)


def steady_force(velocity: Array, friction: StaticFriction) -> Array:
    """Return the steady friction force (9) at velocities other than zero, shape (n,) [N]; sigma_f only, without B0."""
    decay = np.exp(-((np.abs(velocity) / friction.stribeck_velocity) ** friction.stribeck_exponent))
    level = friction.coulomb_force + (friction.static_force - friction.coulomb_force) * decay  # (7)
    force: Array = np.sign(velocity) * level + friction.viscous_coefficient * velocity
    return force


def problem(velocity: Array, force: Array, weight: Array | None = None, viscous_damping: float = 0.0) -> Problem:
    """Pose the fit of the steady friction.

    Args:
        velocity: velocities, shape (n,) [m/s].
        force: driving force at each less its known parts, such as the spring's, shape (n,) [N].
        weight: factor of each residual, in 1/N for residuals in standard deviations; None: 1, as in (21).
        viscous_damping: B0, which no data can separate from sigma_f [N s/m].

    Raises:
        BadInput: the arrays differ in shape, have fewer values than there are unknowns, or hold a value that is not finite,
            a velocity of zero or a negative weight.
    """
    where = "static friction"
    weight = np.ones_like(velocity, dtype=np.float64) if weight is None else weight
    v, f, w = (np.ascontiguousarray(values, dtype=np.float64) for values in (velocity, force, weight))
    size = len(StaticFriction._fields)
    if v.ndim != 1 or v.shape != f.shape or v.shape != w.shape or v.size < size:
        shapes = f"velocity, force and weight of shape {v.shape}, {f.shape} and {w.shape}"
        raise BadInput(shapes, where, f"one shape (n,) with n of {size} or more")
    for name, values, usable, expected in (
        ("velocity", v, np.isfinite(v) & (v != 0.0), "finite and not zero, the sign of friction being unknown there"),
        ("force", f, np.isfinite(f), "finite"),
        ("weight", w, np.isfinite(w) & (w >= 0.0), "finite and not below zero"),
    ):
        if not usable.all():
            first = int(np.argmin(usable))
            raise BadInput(f"{name} {first} is {values[first]:g}", where, expected)
    if not np.any(f):
        raise BadInput("every force is 0", where, "a measured force")
    largest = float(np.abs(f).max())
    slowest, fastest = _ends(v)
    return Problem(
        residuals=residuals,
        data=Data(v, np.sign(v), np.log(np.abs(v)), f, w, float(viscous_damping), slowest, fastest),
        residual_count=v.size,
        # A rig file requires Fc above zero.
        lower=np.array([1e-6 * largest, 0.0, 0.0, LOWEST_EXPONENT, 0.0]),
        upper=np.array([largest, largest, 1.0, HIGHEST_EXPONENT, 1.2 * largest / math.exp(fastest)]),
        name=where,
    )


def friction_of(x: Array, velocity: Array) -> StaticFriction:
    """Return the coefficients represented by coordinates, for data at these velocities, shape (n,) [m/s]."""
    slowest, fastest = _ends(velocity)
    coulomb, visible, w, exponent, viscous = map(float, x)
    log_velocity = _log_velocity(w, exponent, slowest, fastest)
    excess = visible * math.exp(math.exp(exponent * (slowest - log_velocity)))
    return StaticFriction(coulomb, coulomb + excess, math.exp(log_velocity), exponent, viscous)


def _ends(velocity: Array) -> tuple[float, float]:
    """Return the logarithms of the slowest and the fastest speed in m/s."""
    speed = np.abs(velocity)
    return math.log(speed.min()), math.log(speed.max())
