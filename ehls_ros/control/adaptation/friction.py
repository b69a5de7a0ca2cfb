"""Estimate friction level, viscous coefficient and mass from the force after reversals of the motion.

Over a short window, the residual force of the balance (3) is friction plus the unknown external force:

    Ac pL - (ks + kc) x - (B0 + cc) v - m x'' - m g = F(level) + sigma_f v + d(t)

After a reversal the elements are strained in the other direction, and after a known travel they break away: the friction stops
growing. The time of break-away determines the level for any external force without a corner there: within the window the
external force is a polynomial. The elements (6), (8) follow the measured motion at a trial level and at a slightly higher one;
the difference is the regressor of the level. A better level is tried next, so the estimate does not depend on the rig file's.
All signals pass the same filter, so that differentiated readings have the same delay and smoothness as the others.

The friction of the actuator under test breaks away at nearly the same time and moves the far end of the coupling. In windows
long enough to distinguish it from noise, the external force therefore has a corner, placed where it explains most. This is not
a model of the actuator, so the standard error has a lower bound for the remaining error.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.polynomial.legendre import legvander

from ehls_ros.arrays import Array, in_python, kernel
from ehls_ros.control.controllers.base import Model
from ehls_ros.control.rig_scale import PAPER_FORCE, largest_force
from ehls_ros.physics.friction import gms
from ehls_ros.physics.friction.gms import level as sliding_level

RING = 4096
"""Cycles in the ring buffer."""

POSITION, FORCE, SIGNALS = range(3)
"""Columns of the ring: position [m] and driving force [N]."""

SEEN, DIRECTION, FURTHEST, FURTHEST_AT, REVERSED_AT, TURNED_AT, TRACKED = range(7)
"""Indices of the track: number of contiguous cycles, direction of motion, furthest position [m] and its cycle; cycle of the
last reversal, and cycle when the motion back was long enough; and the length of the track."""

LEVEL_STEP = 1.02
"""Ratio of the higher level to the trial level, to form the derivative of friction by the level."""

BEFORE = 2000
"""Cycles before a window in which the elements follow the motion, to forget their initial forces."""

MIN_LEVEL, MAX_LEVEL = 0.4, 2.5
"""Bounds of the trial level, relative to the rig file's."""

STEPS, CONVERGED = 5, 2e-4
"""Most levels tried for a reversal, and the change below which the iteration stops."""

MAX_HALF = 10
"""Longest half-width of the position average that yields the velocity, in cycles."""

VELOCITY_NOISE = 0.15
"""Largest velocity noise relative to the Stribeck velocity, which it must resolve."""

BACK = 1.3
"""Motion back after which a reversal is detected, relative to the travel at which the last element breaks away."""

AROUND = 0.8
"""Half-width of a window relative to the time from reversal to break-away."""

MIN_HALF_WIDTH = 12
"""Least half-width of a window, in cycles."""

WIDTH = 6
"""Half-width of a window relative to the filter's width."""

DEGREES = (2, 3, 4)
"""Degrees of the polynomials tried for the external force."""

PRIOR_STD = 0.3
"""Prior standard deviation of the relative errors of viscous coefficient and mass."""

LEVEL, VISCOUS, MASS, SOUGHT = range(4)
"""Indices of an estimate's entries, and its length."""

POINTS = 60
"""Approximate number of points to which a window is decimated."""

MIN_RESIDUAL = 0.05
"""Least residual force on the paper's rig, for the weights [N], scaled with the rig's force."""

REVERSALS = 2
"""Fewest reversals for an estimate."""

TWO_SIGMAS = 0.97725
"""Probability below two standard deviations of a normal distribution."""

LONG = 50
"""Half-width of a window, in cycles, from which on a corner of the external force is distinguished from noise."""

CORNERS = 33
"""Positions of the corner that are tried in a window."""

COUPLED_FLOOR, COUPLED_LONG_FLOOR = 0.04, 0.015
"""Least standard errors of the level with friction in the actuator under test, in short and in long windows."""

FLOORS = (5e-3, 1e-2, 1e-2)
"""Least relative standard errors."""

NONE = gms.Parameters(1.0, 1.0, 1.0, 1.0, 0.0, (1.0,), (1.0,), 1.0)
"""Placeholder for a friction model whose level is not estimated."""


class Found(NamedTuple):
    """Friction level, viscous coefficient and mass relative to the rig file's, and standard errors, shape (SOUGHT,) each."""

    values: Array
    std: Array


class Surroundings(NamedTuple):
    """Coupling in the force balance, besides the plant.

    Attributes:
        stiffness: stiffness of the coupling to the actuator under test [N/m].
        damping: damping of the coupling [N s/m].
    """

    stiffness: float
    damping: float


def travel(friction: gms.Parameters) -> float:
    """Return the motion back at which the last element breaks away [m]."""
    return 2.0 * gms.break_away(friction) * friction.coulomb_force / friction.static_force


def half_of(noise: float, period: float, friction: gms.Parameters) -> int:
    """Return the number of position readings on either side from which a velocity is formed, given their noise [m]."""
    for half in range(1, MAX_HALF):
        if noise * math.sqrt(2.0 / half) <= VELOCITY_NOISE * friction.stribeck_velocity * (half + 1) * period:
            return half
    return MAX_HALF


@kernel
def _slide(position: Array, velocity: Array, level: float, period: float, p: gms.Parameters) -> Array:
    """Return the sum of the elements' forces [N] along a motion [m, m/s], at a level relative to the rig file's."""
    n = len(p.element_stiffness)
    forces, mode = np.zeros(n), np.zeros(n)
    sliding = np.zeros(len(position))
    ends = level * sliding_level(velocity[0], p)
    for k in range(1, len(position)):
        moved, direction = position[k] - position[k - 1], math.copysign(1.0, velocity[k])
        begins = direction * abs(ends)
        ends = direction * level * sliding_level(velocity[k], p)
        for i in range(n):
            weight, remaining = p.element_weight[i], 1.0
            if mode[i] * direction < 0.0:
                mode[i] = 0.0
            if mode[i] == 0.0:
                short = max(direction * (weight * begins - forces[i]), 0.0)
                forces[i] += p.element_stiffness[i] * moved  # (6)
                beyond = direction * (forces[i] - weight * ends)
                if beyond > 0.0:
                    # Fraction of the cycle after the force crosses the break-away limit.
                    remaining = beyond / (beyond + short)
                    forces[i], mode[i] = weight * (ends + remaining * (begins - ends)), direction
            if mode[i] != 0.0:
                mean = ends + 0.5 * remaining * (begins - ends)
                passed = -math.expm1(-level * p.attraction_rate / abs(mean) * remaining * period)
                forces[i] += (weight * mean - forces[i]) * passed  # (8)
            sliding[k] += forces[i]
    return sliding


@kernel
def follow(position: float, force: float, longest: float, track: Array, ring: Array) -> None:
    """Add one cycle to the track and the ring.

    Args:
        position: piston position [m]; if it or the force is not finite, the track restarts.
        force: driving force [N].
        longest: motion back after which a reversal is detected [m].
        track: by the indices above; updated.
        ring: signals of the last cycles, shape (RING, SIGNALS); updated.
    """
    if not math.isfinite(position + force):
        track[SEEN] = track[DIRECTION] = 0.0
        return
    now = int(track[SEEN])
    ring[now % RING, POSITION], ring[now % RING, FORCE] = position, force
    track[SEEN] += 1.0
    if now == 0:
        track[FURTHEST], track[FURTHEST_AT], track[REVERSED_AT] = position, 0.0, -1.0
    if track[DIRECTION] == 0.0:
        if abs(position - track[FURTHEST]) > longest:
            track[DIRECTION] = 1.0 if position > track[FURTHEST] else -1.0
    elif track[DIRECTION] * (track[FURTHEST] - position) > longest:
        track[REVERSED_AT], track[TURNED_AT] = track[FURTHEST_AT], now
        track[DIRECTION] = -track[DIRECTION]
        track[FURTHEST], track[FURTHEST_AT] = position, now
    if track[DIRECTION] * (position - track[FURTHEST]) >= 0.0 and track[DIRECTION] != 0.0:
        track[FURTHEST], track[FURTHEST_AT] = position, now


class Reversals:
    """Estimates from the reversals so far, with forgetting."""

    def __init__(self, model: Model, surroundings: Surroundings, forgetting: float) -> None:
        """Start without reversals.

        Args:
            model: the rig file's.
            surroundings: coupling of the piston.
            forgetting: time constant of the forgetting of reversals [s].
        """
        self._model = model
        self._surroundings = surroundings
        self._forgetting = forgetting
        self._travel = travel(model.friction)
        self._level = 1.0
        self._half = half_of(model.noise.position, model.period, model.friction)
        self._taken = -1.0
        self._tried = 0
        self._seen = 0
        self._weight = 0.0
        self._sums = np.zeros((4, len(DEGREES), SOUGHT))

    def look(self, track: Array, ring: Array) -> None:
        """Try a level on the last reversal with a complete window; add it once converged or after :data:`STEPS` trials."""
        reversed_at, turned_at, now = int(track[REVERSED_AT]), int(track[TURNED_AT]), int(track[SEEN])
        if reversed_at <= self._taken or turned_at - reversed_at >= RING // 4:
            return
        back = ring[np.arange(reversed_at, turned_at + 1) % RING, POSITION]
        elapsed = int(np.argmax(np.abs(back - back[0]) >= self._level * self._travel)) or turned_at - reversed_at
        half = max(int(AROUND * elapsed), MIN_HALF_WIDTH)
        # Wider windows are smoothed more, as their features are slower.
        width = max(half // (2 * WIDTH), 1) * 2 + 1
        margin, centre = half + width, reversed_at + elapsed
        if now < centre + margin + MAX_HALF + 1:
            return
        begin = max(centre - margin - BEFORE, MAX_HALF)
        if centre - margin < 2 * MAX_HALF or now - begin >= RING:
            self._taken = reversed_at
            return
        rows = ring[np.arange(begin, centre + margin + 1) % RING]
        values, variance, weights = self._fit(rows, centre - margin - begin, width)
        level = float(np.average(values[:, LEVEL], weights=weights[:, 0]))
        self._tried += 1
        change, self._level = abs(level - self._level), min(max(level, MIN_LEVEL), MAX_LEVEL)
        if change < CONVERGED or self._tried == STEPS:
            self._taken, self._tried = reversed_at, 0
            self._add(values, variance, weights, 2.0 * half * self._model.period)

    def interrupt(self) -> None:
        """Reset the state after the cycle count has restarted."""
        self._taken = -1.0
        self._tried = 0

    def found(self) -> Found | None:
        """Return the estimate from all reversals; None while there are too few."""
        if self._seen < REVERSALS:
            return None
        weights = self._sums[0]
        means, squares, own = self._sums[1:] / weights
        share = weights / weights.sum(axis=0)
        value = (share * means).sum(axis=0)
        freedoms = max(self._weight - 1.0, 1.0)
        scatter = (share * np.maximum(squares - means**2, 0.0)).sum(axis=0) / freedoms
        disagreement = (share * (means - value) ** 2).sum(axis=0)
        # An error due to poor excitation recurs in the next window: a window's variance does not average out.
        lasting = (share * own).sum(axis=0)
        # By Student's t: a few reversals that agree by chance, such as those of the first half second, seem too exact.
        few = 0.5 * float(scipy.special.stdtrit(freedoms, TWO_SIGMAS))
        return Found(value, few * np.sqrt(scatter + disagreement + lasting))

    def _add(self, values: Array, variance: Array, weights: Array, duration: float) -> None:
        # Forgetting is per duration of a reversal, so that rare reversals count equally long.
        fading = math.exp(-duration / self._forgetting)
        self._seen += 1
        self._weight = fading * self._weight + 1.0
        self._sums = fading * self._sums + weights * np.stack((np.ones_like(values), values, values**2, variance))

    def _fit(self, rows: Array, before: int, width: int) -> tuple[Array, Array, Array]:
        """Return per degree the estimates relative to the rig file's, their variance, and the degrees' weights.

        The shapes are (DEGREES, SOUGHT), the same, and (DEGREES, 1). The window begins ``before`` cycles after the first row.
        """
        plant, friction, around = self._model.plant, self._model.friction, self._surroundings
        period, level = self._model.period, self._level
        position, velocity = (
            scipy.signal.savgol_filter(rows[:, POSITION], 2 * self._half + 1, 2, deriv=d, delta=period) for d in (0, 1)
        )
        sliding = [_slide(position, velocity, tried, period, friction) for tried in (level, LEVEL_STEP * level)]
        window = np.column_stack((rows, *sliding))[before:]
        smooth = _twice_averaged(window, width)
        bent = window[2 * width :, POSITION] - 2.0 * window[width:-width, POSITION] + window[: -2 * width, POSITION]
        acceleration = bent / (width * period) ** 2
        velocity = (smooth[2:, POSITION] - smooth[:-2, POSITION]) / (2.0 * period)
        thin = slice(None, None, max(len(acceleration) // POINTS, 1))
        position, force, slid, higher = smooth[1:-1][thin].T
        velocity, acceleration = velocity[thin], acceleration[thin]
        viscous, inertia = friction.viscous_coefficient * velocity, plant.moving_mass * acceleration
        missing = (
            force
            - (plant.spring_stiffness + around.stiffness) * position
            - (plant.viscous_damping + around.damping) * velocity
            - plant.moving_mass * plant.gravity
            - inertia
            - slid
            - viscous
        )
        slope = (higher - slid) / ((LEVEL_STEP - 1.0) * level)
        smoothly = legvander(np.linspace(-1.0, 1.0, len(missing)), DEGREES[-1])
        regressors = np.column_stack((slope, viscous, inertia, smoothly))
        coupled, long = around.stiffness > 0.0, len(window) >= 2 * LONG
        corners = _corners(len(window), width)[thin] if coupled and long else None
        least = MIN_RESIDUAL * in_python(largest_force)(plant) / PAPER_FORCE
        fits = [_solved(regressors[:, : SOUGHT + degree + 1], missing, corners, least) for degree in DEGREES]
        # A degree that explains the window better has a larger weight.
        weights = np.array([1.0 / left**2 for *_, left in fits])
        values, variance = np.array([fit[0] for fit in fits]), np.array([fit[1] for fit in fits])
        floors = np.array(FLOORS)
        if coupled:
            floors[LEVEL] = COUPLED_LONG_FLOOR if long else COUPLED_FLOOR
        # The scatter among degrees and reversals is a better measure of the level's error than one fit.
        variance[:, LEVEL] = 0.0
        return values + np.array([level, 1.0, 1.0]), variance + floors**2, (weights / weights.sum())[:, np.newaxis]


def _solved(regressors: Array, missing: Array, corners: Array | None, least: float) -> tuple[Array, Array, float]:
    """Return the errors of the estimates, their variance, both of shape (SOUGHT,), and the rms residual [N].

    Args:
        regressors: columns of the estimates, then of the polynomial, shape (points, n).
        missing: force to explain [N], shape (points,).
        corners: candidate functions, of which the one that explains most of the residual is used, shape (points, m); None
            without.
        least: lower bound of the residual [N].
    """
    if corners is not None:
        span = np.linalg.qr(regressors)[0]
        beside = corners - span @ (span.T @ corners)
        explained = (missing @ beside) ** 2 / np.sum(beside**2, axis=0)
        regressors = np.column_stack((regressors, corners[:, np.argmax(explained)]))
    free = np.linalg.lstsq(regressors, missing, rcond=None)[0]
    left = max(float(np.sqrt(np.mean((missing - regressors @ free) ** 2))), least)
    # The residual is as structured as the friction: all points together count as one.
    together = left * math.sqrt(len(missing))
    known = np.zeros((2, regressors.shape[1]))
    known[0, VISCOUS] = known[1, MASS] = together / PRIOR_STD
    inverse = np.linalg.pinv(np.vstack((regressors, known)))[:SOUGHT]
    return inverse[:, :-2] @ missing, together**2 * np.sum(inverse**2, axis=1), left


def _corners(rows: int, width: int) -> Array:
    """Return the filter's response to ramps that begin within a window of ``rows`` rows."""
    at = rows * np.linspace(0.1, 0.9, CORNERS)
    return _twice_averaged(np.maximum(np.arange(rows)[:, np.newaxis] - at, 0.0) / rows, width)[1:-1]


def _twice_averaged(window: Array, width: int) -> Array:
    """Return columns averaged twice over ``width`` rows; this shortens them by 2 (``width`` - 1) rows in total."""
    for _ in range(2):
        total = np.vstack((np.zeros(window.shape[1]), np.cumsum(window - window[0], axis=0)))
        window = (total[width:] - total[:-width]) / width + window[0]
    return window
