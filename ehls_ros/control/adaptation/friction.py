"""The friction's level and viscous coefficient, from what the force does at reversals of the motion.

Over a window around a reversal the force that the balance (3) leaves is friction and the unknown external force:

    Ac pL - (ks + kc) x - (B0 + cc) v - m x'' - m g = F(level) + sigma_f v + d(t)

At a reversal the friction changes by twice its level within the travel of its elements. The external force is smooth beside
that, so in a window little longer than the change it is a polynomial, and what is odd at the reversal is friction. The
elements (6), (8) follow the measured position all the time, at the level in use and at one a little higher; the difference
is the level's regressor. All signals go through the same filter, so that a differentiated reading is as late and as smooth as
the others.

A reversal of whatever causes the external force, such as the friction of the actuator under test, is no polynomial. Then
polynomials of different degree disagree, and their disagreement is part of the standard error.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander

from ehls_ros.arrays import Array, kernel
from ehls_ros.control.controllers.base import Model
from ehls_ros.physics.friction import gms
from ehls_ros.physics.friction.gms import level as sliding_level

RING = 4096
"""Cycles that are kept."""

POSITION, FORCE, FRICTION, HIGHER, SIGNALS = range(5)
"""Columns of the ring: position [m], driving force [N], friction at the level in use and at the higher one [N]."""

SEEN, DIRECTION, FURTHEST, FURTHEST_AT, REVERSED_AT, TURNED_AT, TRACKED = range(7)
"""Where the track holds how many cycles were seen on end, the motion's direction, its furthest position [m] and when that was,
and the last reversal: when it was, and when the motion back was long enough; its length."""

HIGHER_BY = 1.02
"""The higher level over that in use."""

HALF = 5
"""Cycles by which the velocity, and so the friction, is behind."""

BACK = 1.25
"""Motion back after which a reversal counts, over that after which all elements slip again."""

LONGER = 1.3
"""Half of a window over the time from the reversal until that."""

SHORTEST = 25
"""Least half of a window, in cycles."""

DEGREES = ((3, 4, 5), (6, 7, 8))
"""Of the polynomials that the external force may be; the second three where the first leave much more."""

MUCH_MORE = 3.0
"""Least ratio of the residuals for that."""

VISCOUS_KNOWN = 0.3
"""Standard deviation of the viscous coefficient's relative error before anything is measured."""

POINTS = 60
"""About how many points a window is thinned out to."""

REVERSALS = 2
"""Fewest reversals of which a mean is formed."""

FLOOR, VISCOUS_FLOOR = 5e-3, 1e-2
"""Least standard errors of level and viscous coefficient, relative."""

NONE = gms.Parameters(1.0, 1.0, 1.0, 1.0, 0.0, (1.0,), (1.0,), 1.0)
"""In place of a friction model whose level is not looked for."""


class Found(NamedTuple):
    """Friction level and viscous coefficient over the rig file's, with standard errors."""

    level: float
    level_std: float
    viscous: float
    viscous_std: float


class Surroundings(NamedTuple):
    """What the balance depends on beside the plant.

    Attributes:
        stiffness: of the coupling to the actuator under test [N/m].
        damping: of it [N s/m].
    """

    stiffness: float
    damping: float


def travel(friction: gms.Parameters) -> float:
    """Return the motion back after which a reversal counts [m]."""
    return 2.0 * BACK * gms.break_away(friction)


@kernel
def _slide(moved: float, velocity: float, level: float, period: float, p: gms.Parameters, forces: Array, mode: Array) -> float:
    """Move the elements on by a cycle, at a level over the rig file's; return their sum [N]."""
    s = level * sliding_level(velocity, p)
    direction = 1.0 if velocity > 0.0 else -1.0
    total = 0.0
    for i in range(len(p.element_stiffness)):
        most = direction * p.element_weight[i] * s
        if mode[i] * velocity < 0.0:
            mode[i] = 0.0
        if mode[i] == 0.0:
            forces[i] += p.element_stiffness[i] * moved  # (6)
            if direction * forces[i] > direction * most:
                forces[i], mode[i] = most, direction
        else:
            forces[i] += (most - forces[i]) * -math.expm1(-level * p.attraction_rate / s * period)  # (8)
        total += forces[i]
    return total


@kernel
def follow(
    position: float,
    force: float,
    level: float,
    period: float,
    p: gms.Parameters,
    longest: float,
    elements: Array,
    track: Array,
    ring: Array,
) -> None:
    """Take in one cycle.

    Args:
        position: [m]; where it or the force is not finite, all starts anew.
        force: driving force [N].
        level: friction level in use, over the rig file's.
        period: of the cycles [s].
        p: the rig file's friction.
        longest: motion back after which a reversal counts [m].
        elements: forces [N] and modes at both levels, shape (4, elements); updated.
        track: by the indices above; updated.
        ring: signals of the last cycles, shape (RING, SIGNALS); updated.
    """
    if not math.isfinite(position + force):
        track[SEEN] = track[DIRECTION] = 0.0
        elements[:, :] = 0.0
        return
    now = int(track[SEEN])
    ring[now % RING, POSITION], ring[now % RING, FORCE] = position, force
    track[SEEN] += 1.0
    if now == 0:
        track[FURTHEST], track[FURTHEST_AT], track[REVERSED_AT] = position, 0.0, -1.0
    if now > 2 * HALF:
        ahead = behind = 0.0
        for i in range(HALF):
            ahead += ring[(now - i) % RING, POSITION]
            behind += ring[(now - 2 * HALF + i) % RING, POSITION]
        velocity = (ahead - behind) / (HALF * (HALF + 1) * period)
        late = (now - HALF) % RING
        moved = ring[late, POSITION] - ring[(now - HALF - 1) % RING, POSITION]
        ring[late, FRICTION] = _slide(moved, velocity, level, period, p, elements[0], elements[1])
        ring[late, HIGHER] = _slide(moved, velocity, HIGHER_BY * level, period, p, elements[2], elements[3])
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
    """What the reversals so far tell, forgetting old ones."""

    def __init__(self, model: Model, surroundings: Surroundings, forgetting: float) -> None:
        """Start with none.

        Args:
            model: the rig file's.
            surroundings: of the piston.
            forgetting: time constant with which reversals are forgotten [s].
        """
        self._model = model
        self._surroundings = surroundings
        self._forgetting = forgetting
        self._taken = -1.0
        self._weight = 0.0
        self._sum = np.zeros((len(DEGREES[0]), 2))
        self._squares = np.zeros((len(DEGREES[0]), 2))

    def look(self, track: Array, ring: Array, level: float) -> None:
        """Take in the last reversal once its window is complete; ``level`` is that in use."""
        reversed_at, now = track[REVERSED_AT], track[SEEN]
        if reversed_at <= self._taken:
            return
        half = max(math.ceil(LONGER * (track[TURNED_AT] - reversed_at)), SHORTEST)
        # Wider windows are smoothed more: what is looked for in them is slower.
        width = max(half // 16, 2) * 2 + 1
        margin = half + width
        if now < reversed_at + margin + HALF + 1:
            return
        self._taken = reversed_at
        if reversed_at - margin < 2 * HALF or now - reversed_at + margin >= RING:
            return
        rows = np.arange(int(reversed_at) - margin, int(reversed_at) + margin + 1) % RING
        self._add(self._fit(ring[rows], level, width), 2.0 * half * self._model.period)

    def interrupt(self) -> None:
        """Let the count of cycles start again."""
        self._taken = -1.0

    def forget(self, now: float) -> None:
        """Start again, at another level in use from cycle ``now`` on."""
        self._taken = now
        self._weight = 0.0
        self._sum[:] = self._squares[:] = 0.0

    def found(self, fewest: int = REVERSALS) -> Found | None:
        """Return what the reversals tell together; None while they are fewer than ``fewest``."""
        if self._weight < 0.9 * fewest:
            return None
        mean = self._sum / self._weight
        scatter = np.maximum(self._squares / self._weight - mean**2, 0.0).max(axis=0) / max(self._weight - 1.0, 0.5)
        disagreement = mean.var(axis=0, ddof=1)
        level, viscous = mean.mean(axis=0)
        std = np.sqrt(scatter + disagreement + np.square((FLOOR, VISCOUS_FLOOR)))
        return Found(float(level), float(std[0]), float(viscous), float(std[1]))

    def _add(self, values: Array, duration: float) -> None:
        # A reversal is forgotten by the time that reversals take, so that rare ones count as long.
        fading = math.exp(-duration / self._forgetting)
        self._weight = fading * self._weight + 1.0
        self._sum = fading * self._sum + values
        self._squares = fading * self._squares + values**2

    def _fit(self, window: Array, level: float, width: int) -> Array:
        """Return level and viscous coefficient over the rig file's for each degree, shape (DEGREES, 2)."""
        plant, friction, around = self._model.plant, self._model.friction, self._surroundings
        period = self._model.period
        smooth = _twice_averaged(window, width)
        bent = window[2 * width :, POSITION] - 2.0 * window[width:-width, POSITION] + window[: -2 * width, POSITION]
        acceleration = bent / (width * period) ** 2
        velocity = (smooth[2:, POSITION] - smooth[:-2, POSITION]) / (2.0 * period)
        smooth = smooth[1:-1]
        thin = slice(None, None, max(len(smooth) // POINTS, 1))
        position, force, sliding, higher = smooth[thin].T
        velocity, acceleration = velocity[thin], acceleration[thin]
        viscous = friction.viscous_coefficient * velocity
        missing = (
            force
            - (plant.spring_stiffness + around.stiffness) * position
            - (plant.viscous_damping + around.damping) * velocity
            - plant.moving_mass * (acceleration + plant.gravity)
            - sliding
            - viscous
        )
        slope = (higher - sliding) / ((HIGHER_BY - 1.0) * level)
        smoothly = legvander(np.linspace(-1.0, 1.0, len(missing)), DEGREES[-1][-1])
        regressors = np.column_stack((slope, viscous, smoothly))
        low, high = (_solved(regressors, missing, degrees) for degrees in DEGREES)
        better = high if high[1] * MUCH_MORE < low[1] else low
        return better[0] + (level, 1.0)


def _solved(regressors: Array, missing: Array, degrees: tuple[int, ...]) -> tuple[Array, float]:
    """Return level and viscous coefficient for each degree, shape (degrees, 2), and what the highest degree leaves [N]."""
    values, left = np.empty((len(degrees), 2)), 0.0
    for row, degree in zip(values, degrees, strict=True):
        used = regressors[:, : degree + 3]
        left = _left(used, missing, np.linalg.lstsq(used, missing, rcond=None)[0])
        # What is left is as structured as the friction: all points together count as one.
        known = np.zeros((1, used.shape[1]))
        known[0, 1] = left * math.sqrt(len(missing)) / VISCOUS_KNOWN
        row[:] = np.linalg.lstsq(np.vstack((used, known)), np.append(missing, 0.0), rcond=None)[0][:2]
    return values, left


def _left(regressors: Array, missing: Array, values: Array) -> float:
    return float(np.sqrt(np.mean((missing - regressors @ values) ** 2)))


def _twice_averaged(window: Array, width: int) -> Array:
    """Return columns averaged over ``width`` rows, twice; shorter by twice ``width`` - 1 rows at both ends together."""
    for _ in range(2):
        total = np.vstack((np.zeros(window.shape[1]), np.cumsum(window - window[0], axis=0)))
        window = (total[width:] - total[:-width]) / width + window[0]
    return window
