"""Static fit (20), (21): Stribeck curve and viscous friction from steady sliding.

Spring, constant force and mass enter (20) linearly. They are subtracted first, with the best coefficients over a coarse grid
of the two nonlinear coefficients. Then an optimiser fits the Stribeck curve to the rest, averaged over classes of velocity.
"""

import itertools
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.identification import stribeck
from ehls_ros.identification.balance import Recorded, linear_columns
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.optimisers.base import Result
from ehls_ros.samples import GAUSS

SETTLE_TIMES = (0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Trial settling times after a reversal or a break-away [s]."""

MAX_CLASSES = 400
"""Maximum number of velocity classes in the fit."""

MIN_TRAVEL = 0.004
"""Minimum travel since a reversal for sliding, as a fraction of the recording's travel."""

MIN_CLASS_BLOCKS = 3
"""Minimum number of blocks in a velocity class."""

MAX_RESIDUAL = 6.0
"""Residual, in standard deviations of the classes' scatter, beyond which a class is left out."""

MIN_BLOCKS = 20
"""Minimum number of blocks of steady sliding for a static fit."""

MIN_RATIO = 1.2
"""Minimum ratio of fast to slow sliding, 90th to 10th percentile of the speed, for a static fit."""

MIN_RARER_FRACTION = 0.02
"""Minimum fraction of the sliding blocks in the rarer direction."""

VELOCITIES = np.geomspace(2e-4, 0.1, 14)
EXPONENTS = (0.5, 0.8, 1.2, 2.0)
"""Grid of the Stribeck velocity [m/s] and exponent while the linear part is fitted."""


class Search(NamedTuple):
    """Settings of the search for the curve.

    Attributes:
        optimiser: name of the optimiser.
        parameters: its parameters.
        seed: seed of its random numbers.
    """

    optimiser: str
    parameters: Any
    seed: int = 0


class StaticFit(NamedTuple):
    """Result of the static fit.

    Attributes:
        friction: the five coefficients.
        linear: fitted linear coefficients out of spring, constant force and mass, by name.
        settle_time: settling time to steady sliding [s].
        velocity: mean velocity of each velocity class, shape (n,) [m/s].
        force: friction force of each class [N].
        deviation: standard deviation of each class's force [N].
        search: result of the optimiser.
    """

    friction: stribeck.StaticFriction
    linear: dict[str, float]
    settle_time: float
    velocity: Array
    force: Array
    deviation: Array
    search: Result


class Classes(NamedTuple):
    """Averages over velocity classes, shape (n,).

    Attributes:
        velocity: mean velocity [m/s].
        force: median force [N].
        deviation: standard deviation of that force [N].
    """

    velocity: Array
    force: Array
    deviation: Array

    def chosen(self, mask: Any) -> "Classes":
        """Return the classes selected by a mask."""
        return Classes(*(values[mask] for values in self))


class Blocks(NamedTuple):
    """Blocks in which the piston moves, shape (n,) unless stated.

    Attributes:
        velocity: velocity [m/s].
        since: time since the last reversal, break-away or gap [s].
        force: driving force [N].
        columns: regressors of the linear coefficients, shape (n, coefficients).
        noise: standard deviation of the force [N].
    """

    velocity: Array
    since: Array
    force: Array
    columns: Array
    noise: Array

    def chosen(self, mask: Any) -> "Blocks":
        """Return the blocks selected by a mask."""
        return Blocks(*(values[mask] for values in self))


def steady_fit(recorded: Recorded, viscous_damping: float, how: Search) -> StaticFit | None:
    """Fit the Stribeck curve.

    Args:
        recorded: the recordings; ``linear`` names the terms to subtract: ``constant``, and ``spring`` and ``mass`` if fitted.
        viscous_damping: B0, which no data can separate from sigma_f [N s/m].
        how: optimiser and seed.

    Returns:
        The fit; None without sufficient steady sliding.

    Raises:
        BadInput: there is sliding in one direction only, so that friction cannot be separated from a constant force.
    """
    if not recorded.motions:
        return None
    blocks = sliding(recorded)
    if len(blocks.velocity) < MIN_BLOCKS:
        return None
    slow, fast = np.quantile(np.abs(blocks.velocity), [0.1, 0.9])
    if fast < MIN_RATIO * slow:
        return None
    forward = float(np.mean(blocks.velocity > 0.0))
    if not MIN_RARER_FRACTION < forward < 1.0 - MIN_RARER_FRACTION:
        way = "forwards" if forward > 0.5 else "backwards"
        raise BadInput(f"position_m slides {way} only", recorded.motions[0].name, "strokes in both directions")
    settle = settle_time(blocks)
    steady = blocks.chosen(blocks.since >= settle)
    coefficients = linear_part(steady)
    classes = averaged(steady.velocity, steady.force - steady.columns @ coefficients, steady.noise)
    if len(classes.velocity) < len(stribeck.StaticFriction._fields):
        return None
    search = _search(classes, viscous_damping, how)
    residual = unexplained(stribeck.friction_of(search.x, classes.velocity), classes, viscous_damping) / classes.deviation
    near = np.abs(residual) <= MAX_RESIDUAL * max(1.0, GAUSS * float(np.median(np.abs(residual))))
    if not np.all(near):
        classes = classes.chosen(near)
        search = _search(classes, viscous_damping, how)
    return StaticFit(
        friction=stribeck.friction_of(search.x, classes.velocity),
        linear=dict(zip(recorded.linear, coefficients.tolist(), strict=True)),
        settle_time=settle,
        velocity=classes.velocity,
        force=classes.force,
        deviation=classes.deviation,
        search=search,
    )


def _search(classes: Classes, viscous_damping: float, how: Search) -> Result:
    problem = stribeck.problem(classes.velocity, classes.force, 1.0 / classes.deviation, viscous_damping)
    return OPTIMISERS.load(how.optimiser).minimise(problem, how.parameters, how.seed)


def unexplained(friction: stribeck.StaticFriction, classes: Classes, viscous_damping: float) -> Array:
    """Return the residual force of each class with respect to the curve, shape (n,) [N]."""
    left: Array = classes.force - viscous_damping * classes.velocity - stribeck.steady_force(classes.velocity, friction)
    return left


def sliding(recorded: Recorded) -> Blocks:
    """Collect the usable blocks in which the piston slides."""
    parts = []
    for motion, good in zip(recorded.motions, recorded.usable, strict=True):
        moves = good & (np.abs(motion.velocity) > 5.0 * motion.velocity_noise)
        direction = np.where(moves, np.sign(motion.velocity), 0.0)
        begins = np.concatenate([[True], direction[1:] != direction[:-1]])
        start = np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0))
        since: Array = np.asarray((np.arange(len(begins)) - start) * motion.period, dtype=np.float64)
        # Right after a reversal the piston only deflects the contact.
        travel = np.abs(motion.position - motion.position[start])
        moves &= travel >= MIN_TRAVEL * float(np.ptp(motion.position[good]) if np.any(good) else 0.0)
        noise = np.full(len(moves), max(motion.force_noise, 1e-9))
        blocks = Blocks(motion.velocity, since, motion.force, linear_columns(motion, recorded.linear), noise)
        parts.append(blocks.chosen(moves))
    return Blocks(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def linear_part(blocks: Blocks) -> Array:
    """Return the linear coefficients, shape (coefficients,): the best over a grid of the Stribeck curve's shape."""
    v, size = blocks.velocity, blocks.columns.shape[1]
    direction = np.sign(v)
    best, lowest = np.zeros(size), np.inf
    rows = np.column_stack([blocks.columns, v, direction, direction]) / blocks.noise[:, np.newaxis]
    target = blocks.force / blocks.noise
    for velocity in VELOCITIES:
        for exponent in EXPONENTS:
            rows[:, -1] = direction * np.exp(-((np.abs(v) / velocity) ** exponent)) / blocks.noise
            # Normal equations, since they are small; scaled, since the columns have different units.
            scale = np.sqrt(np.sum(rows**2, axis=0)) + 1e-300
            scaled = rows / scale
            solution, *_ = np.linalg.lstsq(scaled.T @ scaled, scaled.T @ target, rcond=1e-12)
            cost = float(np.sum((target - scaled @ solution) ** 2))
            if cost < lowest:
                best, lowest = (solution / scale)[:size], cost
    return best


def settle_time(blocks: Blocks) -> float:
    """Return the shortest settling time after which friction no longer changes [s]."""
    for shorter, longer in itertools.pairwise(SETTLE_TIMES):
        early = (blocks.since >= shorter) & (blocks.since < longer)
        late = blocks.since >= longer
        if late.sum() < MIN_BLOCKS:
            return shorter
        if early.sum() < MIN_BLOCKS:
            continue
        settled = blocks.chosen(late)
        friction = (blocks.force - blocks.columns @ linear_part(settled)) * np.sign(blocks.velocity)
        edges = np.quantile(np.abs(settled.velocity), np.linspace(0.0, 1.0, 11))
        where = np.clip(np.searchsorted(edges, np.abs(blocks.velocity)) - 1, 0, 9)
        # At equal velocities, since friction depends on velocity.
        apart = []
        for i in range(10):
            a, b = friction[early & (where == i)], friction[late & (where == i)]
            if len(a) > 4 and len(b) > 4:
                spread = np.std(b) / np.sqrt(len(a)) + 1e-9
                apart.append(abs(float(np.median(a) - np.median(b))) / spread)
        if apart and float(np.median(apart)) < 3.0:
            return shorter
    return SETTLE_TIMES[-1]


def averaged(velocity: Array, force: Array, noise: Array) -> Classes:
    """Average over velocity classes with about equally many blocks; medians make the forces robust to outliers.

    Args:
        velocity: of the blocks, shape (n,) [m/s].
        force: friction force, shape (n,) [N].
        noise: standard deviation of each force, shape (n,) [N].
    """
    order = np.argsort(velocity)
    v, f, noise = velocity[order], force[order], noise[order]
    # Equal speeds stay together: a class ends before a step of velocity of 1 %, or when full.
    full = max(MIN_CLASS_BLOCKS, len(v) // MAX_CLASSES)
    jumps = np.flatnonzero(np.diff(v) > 0.01 * np.maximum(np.abs(v[1:]), 1e-6)) + 1
    edges = [0]
    for edge in [*jumps.tolist(), len(v)]:
        while edge - edges[-1] > 2 * full:
            edges.append(edges[-1] + full)
        if edge > edges[-1]:
            edges.append(edge)
    classes = [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= MIN_CLASS_BLOCKS]
    count = np.array([c.stop - c.start for c in classes])
    return Classes(
        velocity=np.array([v[c].mean() for c in classes]),
        force=np.array([np.median(f[c]) for c in classes]),
        deviation=np.array([noise[c].mean() for c in classes]) * np.sqrt(np.pi / 2.0 / count),
    )
