"""The static fit (20), (21): Stribeck curve and viscous friction from steady sliding.

Spring, constant force and mass enter (20) in a straight line. They are taken out first, with the Stribeck curve
left free over a coarse grid of its two bent coefficients; then an optimiser fits the curve to what is left,
averaged over classes of velocity.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.identification import stribeck
from ehls_ros.identification.gms_force import linear_columns
from ehls_ros.identification.motion import Motion
from ehls_ros.identification.optimisers import OPTIMISERS
from ehls_ros.identification.optimisers.base import Result
from ehls_ros.samples import GAUSS, Mask

SETTLE_TIMES = (0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Times after a reversal or a break-away that are tried as the end of settling [s]."""

CLASSES = 400
"""Most classes of velocity the fit works on."""

LEAST_WAY = 0.004
"""Way after a turn from which the piston slides, as a part of the recording's travel."""

FEW = 3
"""Blocks a class of velocity needs."""

FAR = 6.0
"""Standard deviations, as the classes scatter, at which a class is left out."""

LEAST_BLOCKS = 20
"""Blocks of steady sliding below which there is no static fit."""

VELOCITIES = np.geomspace(2e-4, 0.1, 14)
EXPONENTS = (0.5, 0.8, 1.2, 2.0)
"""Grid of the Stribeck velocity [m/s] and exponent while the straight part is taken out."""


class StaticFit(NamedTuple):
    """What steady sliding says.

    Attributes:
        friction: the five coefficients.
        linear: spring, constant force and mass as far as they were fitted, by name.
        settle_time: time after which sliding counts as steady [s].
        velocity: classes of velocity, shape (n,) [m/s].
        force: friction force of each class [N].
        deviation: standard deviation of each class's force [N].
        search: how the optimiser went.
    """

    friction: stribeck.StaticFriction
    linear: dict[str, float]
    settle_time: float
    velocity: Array
    force: Array
    deviation: Array
    search: Result


class _Blocks(NamedTuple):
    velocity: Array
    since: Array
    force: Array
    columns: Array
    noise: Array


def steady_fit(
    motions: Sequence[Motion],
    usable: Sequence[Mask],
    linear: Sequence[str],
    viscous_damping: float,
    optimiser: str,
    parameters: Any,
    seed: int,
) -> StaticFit | None:
    """Fit the Stribeck curve.

    Args:
        motions: the recordings.
        usable: blocks of each that may count.
        linear: straight-line coefficients to take out, ``constant`` and those of ``spring`` and ``mass`` that are fitted.
        viscous_damping: B0, which the data cannot tell from sigma_f [N s/m].
        optimiser: name of the optimiser.
        parameters: its parameters.
        seed: seed of its random numbers.

    Returns:
        The fit; None where nothing slides steadily for long enough.

    Raises:
        BadInput: sliding goes one way only, so that friction cannot be told from a constant force.
    """
    if not motions:
        return None
    blocks = _sliding(motions, usable, linear)
    if len(blocks.velocity) < LEAST_BLOCKS or np.ptp(np.abs(blocks.velocity)) <= 0.0:
        return None
    forward = float(np.mean(blocks.velocity > 0.0))
    if not 0.02 < forward < 0.98:
        way = "forwards" if forward > 0.5 else "backwards"
        raise BadInput(f"position_m slides {way} only", motions[0].name, "strokes in both directions")
    settle = _settle_time(blocks)
    steady = blocks.since >= settle
    v, f, c = blocks.velocity[steady], blocks.force[steady], blocks.columns[steady]
    coefficients = _straight_part(v, f, c, blocks.noise[steady])
    velocity, force, deviation = _classes(v, f - c @ coefficients, blocks.noise[steady])
    search = _search(velocity, force, deviation, viscous_damping, optimiser, parameters, seed)
    left = _left_over(search, velocity, force, viscous_damping) / deviation
    near = np.abs(left) <= FAR * max(1.0, GAUSS * float(np.median(np.abs(left))))
    if not np.all(near):
        velocity, force, deviation = velocity[near], force[near], deviation[near]
        search = _search(velocity, force, deviation, viscous_damping, optimiser, parameters, seed)
    return StaticFit(
        friction=stribeck.friction_of(search.x, velocity),
        linear=dict(zip(linear, coefficients.tolist(), strict=True)),
        settle_time=settle,
        velocity=velocity,
        force=force,
        deviation=deviation,
        search=search,
    )


def _search(
    velocity: Array, force: Array, deviation: Array, viscous_damping: float, optimiser: str, parameters: Any, seed: int
) -> Result:
    problem = stribeck.problem(velocity, force, 1.0 / deviation, viscous_damping)
    result: Result = OPTIMISERS.load(optimiser).minimise(problem, parameters, seed)
    return result


def _left_over(search: Result, velocity: Array, force: Array, viscous_damping: float) -> Array:
    """Return the force the curve does not explain, shape (n,) [N]."""
    f = stribeck.friction_of(search.x, velocity)
    level = f.coulomb_force + (f.static_force - f.coulomb_force) * np.exp(
        -((np.abs(velocity) / f.stribeck_velocity) ** f.stribeck_exponent)
    )
    left: Array = force - (viscous_damping + f.viscous_coefficient) * velocity - np.sign(velocity) * level
    return left


def _sliding(motions: Sequence[Motion], usable: Sequence[Mask], linear: Sequence[str]) -> _Blocks:
    """Collect the blocks that move, with the time since each last turned, broke away or had a gap."""
    parts = []
    for motion, good in zip(motions, usable, strict=True):
        moves = good & (np.abs(motion.velocity) > 5.0 * motion.velocity_noise)
        direction = np.where(moves, np.sign(motion.velocity), 0.0)
        begins = np.concatenate([[True], direction[1:] != direction[:-1]])
        start = np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0))
        since = (np.arange(len(begins)) - start) * motion.period
        # On the first bit of its way the piston only pulls the elements along.
        way = np.abs(motion.position - motion.position[start])
        moves &= way >= LEAST_WAY * float(np.ptp(motion.position[good]) if np.any(good) else 0.0)
        noise = np.full(int(moves.sum()), max(motion.force_noise, 1e-9))
        parts.append((motion.velocity[moves], since[moves], motion.force[moves], linear_columns(motion, linear)[moves], noise))
    return _Blocks(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _straight_part(v: Array, f: Array, columns: Array, noise: Array) -> Array:
    """Return the coefficients of the straight part, the best of a grid over the Stribeck curve's shape."""
    direction = np.sign(v)
    best, lowest = np.zeros(columns.shape[1]), np.inf
    rows = np.column_stack([columns, v, direction, direction]) / noise[:, np.newaxis]
    target = f / noise
    for velocity in VELOCITIES:
        for exponent in EXPONENTS:
            rows[:, -1] = direction * np.exp(-((np.abs(v) / velocity) ** exponent)) / noise
            # The normal equations are small, and the columns scaled to one another by nature of the units.
            scale = np.sqrt(np.sum(rows**2, axis=0)) + 1e-300
            scaled = rows / scale
            solution, *_ = np.linalg.lstsq(scaled.T @ scaled, scaled.T @ target, rcond=1e-12)
            cost = float(np.sum((target - scaled @ solution) ** 2))
            if cost < lowest:
                best, lowest = (solution / scale)[: columns.shape[1]], cost
    return best


def _settle_time(blocks: _Blocks) -> float:
    """Return the shortest time after which waiting longer no longer changes the friction that comes out."""
    for shorter, longer in itertools.pairwise(SETTLE_TIMES):
        early = (blocks.since >= shorter) & (blocks.since < longer)
        late = blocks.since >= longer
        if late.sum() < LEAST_BLOCKS:
            return shorter
        if early.sum() < LEAST_BLOCKS:
            continue
        v, f, c, noise = (values[late] for values in (blocks.velocity, blocks.force, blocks.columns, blocks.noise))
        coefficients = _straight_part(v, f, c, noise)
        friction = (blocks.force - blocks.columns @ coefficients) * np.sign(blocks.velocity)
        edges = np.quantile(np.abs(v), np.linspace(0.0, 1.0, 11))
        where = np.clip(np.searchsorted(edges, np.abs(blocks.velocity)) - 1, 0, 9)
        # Compare the same velocities, before and after.
        apart = []
        for i in range(10):
            a, b = friction[early & (where == i)], friction[late & (where == i)]
            if len(a) > 4 and len(b) > 4:
                spread = np.std(b) / np.sqrt(len(a)) + 1e-9
                apart.append(abs(float(np.median(a) - np.median(b))) / spread)
        if apart and float(np.median(apart)) < 3.0:
            return shorter
    return SETTLE_TIMES[-1]


def _classes(v: Array, f: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Average over classes of velocity that hold about as many blocks each; medians, so that stragglers do not matter."""
    order = np.argsort(v)
    v, f, noise = v[order], f[order], noise[order]
    # Speeds that belong together stay together: a class ends where the next velocity is 1 % away, or the class is full.
    full = max(1, len(v) // CLASSES)
    jumps = np.flatnonzero(np.diff(v) > 0.01 * np.maximum(np.abs(v[1:]), 1e-6)) + 1
    edges = [0]
    for edge in [*jumps.tolist(), len(v)]:
        while edge - edges[-1] > 2 * full:
            edges.append(edges[-1] + full)
        if edge > edges[-1]:
            edges.append(edge)
    classes = [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= FEW]
    velocity = np.array([v[c].mean() for c in classes])
    force = np.array([np.median(f[c]) for c in classes])
    count = np.array([c.stop - c.start for c in classes])
    deviation = np.array([noise[c].mean() for c in classes]) * np.sqrt(np.pi / 2.0 / count)
    return velocity, force, deviation
