"""Hysteresis loop (22), (23): friction elements from its branches, without nodes picked by hand.

After a reversal each element sticks until its force has changed from one limit to the other. So the force gained since the
reversal is a sum of ramps, sum k_i min(d, D_i), with the travel d since then and D_i = 2 alpha_i s/k_i. Ramps with many ends
are fitted at once by non-negative least squares; the few that remain are the elements. Used for models with friction elements.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.identification.motion import Motion
from ehls_ros.physics.friction.gms import Parameters as Friction
from ehls_ros.samples import Mask

RAMPS = 60
"""Number of ramp ends tried."""

POINTS = 200
"""Number of points of the mean branch."""

STICKING, MIN_STICKING = 0.8, 3
"""Used fraction of the travel after a reversal on which all elements stick, and the fewest blocks in it."""

MIN_BRANCHES = 3
"""Fewest branches for a mean."""


class Branch(NamedTuple):
    """The mean branch of all reversals, shape (n,).

    Attributes:
        way: travel since the reversal [m].
        force: friction force gained since the reversal [N].
        branches: number of branches averaged.
    """

    way: Array
    force: Array
    branches: int


class Node(NamedTuple):
    """A bend of the branch, where an element starts to slip.

    Attributes:
        way: travel since the reversal [m].
        force: force gained by then [N].
        slope: slope of the branch before it, K_i [N/m].
    """

    way: float
    force: float
    slope: float


def mean_branch(motions: Sequence[Motion], usable: Sequence[Mask], rest: Sequence[Array]) -> Branch | None:
    """Return the mean of all branches between successive reversals.

    Args:
        motions: the recordings.
        usable: mask of the blocks to be used of each.
        rest: force balance of each without the friction elements, to be subtracted, shape (n,) each [N].

    Returns:
        The branch; None if there are too few reversals.
    """
    pieces: list[tuple[Array, Array]] = []
    for motion, good, other in zip(motions, usable, rest, strict=True):
        friction = motion.force - other
        for start, end in itertools.pairwise(motion.turns.tolist()):
            if end - start < 8 or not np.all(good[start - 1 : end]):
                continue
            way = np.abs(motion.position[start:end] - _turning_point(motion.position, start))
            gained = np.abs(friction[start:end] - _turning_point(friction, start))
            pieces.append((way, gained))
    if len(pieces) < MIN_BRANCHES:
        return None
    longest = float(np.median([way[-1] for way, _ in pieces]))
    grid = np.linspace(0.0, longest, POINTS)
    rows = [np.interp(grid, way, force, right=np.nan) for way, force in pieces]
    with np.errstate(invalid="ignore"):
        mean = np.nanmedian(rows, axis=0)
    return Branch(grid, mean, len(pieces))


def corrected_turns(motion: Motion, left: Array, friction: Friction) -> Motion:
    """Return a motion with its turning points corrected by the force.

    Around a reversal the piston moves to and fro by less than the sensor resolves. Each micrometre further before the reversal
    lowers the force of the sticking elements by their total stiffness. So the residual force while all stick reveals the missed
    travel, which is added before the reversal and subtracted after it.

    Args:
        motion: the recording.
        left: residual force of a fit, shape (n,) [N]; NaN where a block does not count.
        friction: the fitted friction.
    """
    stiffness = float(np.sum(friction.element_stiffness))
    shortest = min(
        2.0 * a * friction.coulomb_force / k for a, k in zip(friction.element_weight, friction.element_stiffness, strict=True)
    )
    velocity = motion.velocity.copy()
    for turn, end in itertools.pairwise([*motion.turns.tolist(), len(velocity)]):
        way = np.abs(motion.position[turn:end] - motion.position[turn])
        if len(way) < 2 or way.max() < shortest:
            continue  # oscillation in place
        sticks = left[turn:end][way < STICKING * shortest]
        sticks = sticks[np.isfinite(sticks)]
        if len(sticks) < MIN_STICKING:
            continue
        direction = np.sign(motion.velocity[turn - 1])
        missed = float(np.clip(-direction * np.median(sticks) / stiffness, -motion.turn_doubt, motion.turn_doubt))
        velocity[turn - 1] += direction * missed / motion.period
        velocity[turn] -= direction * missed / motion.period
    return motion._replace(velocity=velocity)


def _turning_point(values: Array, at: int) -> float:
    """Return the value of a signal at a reversal, between the blocks ``at - 1`` and ``at``."""
    return float(0.5 * (values[at - 1] + values[at]))


def ramps(branch: Branch) -> tuple[Array, Array]:
    """Return ends D [m] and stiffness k [N/m] of the ramps that add up to a branch, by non-negative least squares."""
    shortest = max(branch.way[-1] / 500.0, 1e-9)
    ends = np.geomspace(shortest, branch.way[-1], RAMPS)
    columns = np.minimum(branch.way[:, np.newaxis], ends)
    scale = np.linalg.norm(columns, axis=0)
    stiffness, _ = scipy.optimize.nnls(columns / scale, np.nan_to_num(branch.force))
    stiffness = stiffness / scale
    kept = stiffness * ends > 1e-3 * np.sum(stiffness * ends)
    return ends[kept], stiffness[kept]


def merged(ends: Array, stiffness: Array, elements: int) -> tuple[Array, Array]:
    """Return the ramps merged to a number of elements, neighbours with the closest ends first.

    Args:
        ends: ends of the ramps, increasing, shape (n,) [m].
        stiffness: their stiffness, shape (n,) [N/m].
        elements: number of elements; if there are fewer ramps, the strongest are split.

    Returns:
        Ends and stiffness, shape (elements,). Their total force and total stiffness stay the same.
    """
    d, k = list(ends), list(stiffness)
    while len(d) > elements:
        gaps = [np.log(d[i + 1] / d[i]) * min(d[i] * k[i], d[i + 1] * k[i + 1]) for i in range(len(d) - 1)]
        i = int(np.argmin(gaps))
        force, both = d[i] * k[i] + d[i + 1] * k[i + 1], k[i] + k[i + 1]
        d[i : i + 2], k[i : i + 2] = [force / both], [both]
    while len(d) < elements:
        i = int(np.argmax(np.multiply(d, k)))
        d[i : i + 1], k[i : i + 1] = [0.6 * d[i], 1.4 * d[i]], [0.5 * k[i], 0.5 * k[i]]
    return np.array(d), np.array(k)


def nodes(ends: Array, stiffness: Array) -> list[Node]:
    """Return the nodes N1, N2, ... of the branch of some elements, with the slopes K_i of (22).

    Args:
        ends: travel at which each starts to slip, shape (n,) [m].
        stiffness: stiffness of each, shape (n,) [N/m].
    """
    order = np.argsort(ends)
    d, k = ends[order], stiffness[order]
    return [Node(float(d[i]), float(np.sum(k * np.minimum(d, d[i]))), float(np.sum(k[i:]))) for i in range(len(d))]
