"""Statistics of a healthy rig's blocks: level, scatter, correlation, and spread from section to section.

A section is a time over which a rig runs under one condition: a recording, or the blocks after an operating point was accepted.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules


class Healthy(NamedTuple):
    """Statistics of each quantity over the blocks of a healthy rig.

    Attributes:
        level: mean size; 0 for a rig equal to its model, shape (n,).
        certainty: information of the level; infinite if the level is given, shape (n,).
        scatter: standard deviation of a block's score, divided by the root of its information, shape (n,).
        spread: standard deviation of the size from section to section, shape (n,).
        dependence: ratio of the variance of a sum over blocks to that of independent ones, shape (n,).
        freedom: degrees of freedom of the scatter.
        remainder: rms residual of a healthy rig beyond noise, as a fraction of the largest term of its balance, shape (n,). Up
            to that much may look like a departure when the rig runs another programme.
    """

    level: Array
    certainty: Array
    scatter: Array
    spread: Array
    dependence: Array
    freedom: float
    remainder: Array


def learn(score: Array, information: Array, section: NDArray[np.intp]) -> Healthy:
    """Estimate the statistics of a healthy rig's blocks.

    Args:
        score: of each quantity in each block, shape (blocks, n).
        information: likewise; 0 if a block holds none, shape (blocks, n).
        section: section of each block, in order, shape (blocks,).
    """
    sections = np.unique(section)
    own = np.array([np.sum(information[section == s], axis=0) for s in sections])
    sums = np.array([np.sum(score[section == s], axis=0) for s in sections])
    sizes = np.divide(sums, own, out=np.zeros_like(sums), where=own > 0.0)
    certainty = np.sum(own, axis=0)
    root = np.sqrt(information)
    # Relative to the section's mean: differences between sections belong to the spread.
    apart = score - sizes[np.searchsorted(sections, section)] * information
    rest = np.divide(apart, root, out=np.zeros_like(score), where=root > 0.0)
    scatter = _scatter(rest, information > 0.0, len(sections))
    dependence = _dependence(np.clip(rest / scatter, -rules.MOST_SCORE, rules.MOST_SCORE), section)
    seen = own > 0.0
    count = np.maximum(np.sum(seen, axis=0), 1)
    level = np.sum(sizes, axis=0) / count
    noise = np.divide(scatter**2 * dependence, own, out=np.zeros_like(own), where=seen)
    between = np.sum(np.where(seen, (sizes - level) ** 2, 0.0), axis=0) - np.sum(noise, axis=0) * (1.0 - 1.0 / count)
    spread = np.sqrt(np.maximum(between, 0.0) / np.maximum(count - 1, 1))
    freedom = rules.LEARNT_BLOCKS + len(score)
    return Healthy(level, certainty, scatter, spread, dependence, freedom, np.zeros_like(level))


def scattering(found: Healthy, more: Healthy) -> Healthy:
    """Return the statistics with the scatter of more blocks, while the level is kept.

    The level must not follow a rig that wears.
    """
    return found._replace(scatter=more.scatter, dependence=more.dependence, freedom=more.freedom)


def _scatter(rest: Array, told: NDArray[np.bool_], sections: int) -> Array:
    """Return the scale at which the limited scores have the variance of unlimited normal ones, shape (n,)."""
    prior = rules.LEARNT_BLOCKS
    count = np.sum(told, axis=0)
    scatter = np.full(rest.shape[1], rules.LEARNT_SCATTER)
    # Each section's mean takes one degree of freedom.
    lost = np.maximum(count - sections, 1) / np.maximum(count, 1)
    for _ in range(50):
        squares = np.sum(np.minimum((rest / scatter) ** 2, rules.MOST_SCORE**2), axis=0) / lost
        grown = (prior * (rules.LEARNT_SCATTER / scatter) ** 2 + squares) / (prior + count)
        scatter = scatter * np.sqrt(grown)
    return np.maximum(scatter, rules.LEAST_SCATTER)


def _dependence(limited: Array, section: NDArray[np.intp]) -> Array:
    """Return the factor by which correlation of neighbouring blocks raises the variance of a sum, shape (n,)."""
    total = np.ones(limited.shape[1])
    power = np.maximum(np.mean(limited**2, axis=0), 1e-12)
    for lag in range(1, rules.LONGEST_DEPENDENCE + 1):
        same = section[lag:] == section[:-lag]
        if np.sum(same) < 2 * rules.LEARNT_BLOCKS:
            break
        correlation = np.mean((limited[lag:] * limited[:-lag])[same], axis=0) / power
        # A correlation within chance for so few blocks does not count.
        beyond = np.abs(correlation) > 2.0 / math.sqrt(float(np.sum(same)))
        total += 2.0 * np.where(beyond, correlation, 0.0)
    return np.maximum(total, 1.0)
