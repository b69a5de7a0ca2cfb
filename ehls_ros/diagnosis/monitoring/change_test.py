"""Test for a change of the rig: sums of block scores over times of seconds to an hour.

Over each of several times up to the newest block, the scores of each quantity are summed and divided by the standard deviation
of a healthy rig's sum. The bound is set so that chance exceeds it once in the mean time between false alarms, with a Bonferroni
correction for all quantities and times. As sums over overlapping times are correlated, false alarms are rarer than that.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.samples import Mask

HOUR = 3600.0
"""An hour [s].

Origin: a unit.
"""


class BlockStatistics(NamedTuple):
    """Statistics of each quantity over the blocks of a healthy rig.

    Attributes:
        level: mean size; 0 for a rig equal to its model, shape (n,).
        certainty: information of the level; infinite if the level is given, shape (n,).
        scatter: standard deviation of a block's score, divided by the root of its information, shape (n,).
        spread: standard deviation of the size from section to section, shape (n,).
        dependence: ratio of the variance of a sum over blocks to that of independent ones, shape (n,).
        freedom: degrees of freedom of the scatter.
        variation: standard deviation of the size from block to block beyond noise, shape (n,): the part of the model's
            remainder that looks like a departure, which is another one when the rig runs another programme. It is unknown,
            infinite, from a single section, which may be of one programme.
        varied: number of blocks from which it is known, shape (n,).
        remainder: rms residual of a healthy rig beyond noise, as a fraction of the largest term of its balance, shape (n,). No
            more than that can look like a departure.
    """

    level: Array
    certainty: Array
    scatter: Array
    spread: Array
    dependence: Array
    freedom: float
    variation: Array
    varied: Array
    remainder: Array


def block_statistics(score: Array, information: Array, section: NDArray[np.intp]) -> BlockStatistics:
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
    variation, informed = _variation(score, information)
    variation = variation if len(sections) > 1 else np.full_like(level, np.inf)
    return BlockStatistics(level, certainty, scatter, spread, dependence, freedom, variation, informed, np.zeros_like(level))


def _variation(score: Array, information: Array) -> tuple[Array, Array]:
    """Return the standard deviation of the size from block to block beyond noise, and the number of informed blocks.

    The moment estimate for random effects of DerSimonian and Laird (Controlled Clinical Trials 7, 1986).

    Args:
        score: shape (blocks, n).
        information: shape (blocks, n).

    Returns:
        Both of shape (n,).
    """
    total, count = np.sum(information, axis=0), np.sum(information > 0.0, axis=0)
    level = np.divide(np.sum(score, axis=0), total, out=np.zeros_like(total), where=total > 0.0)
    squares = np.divide((score - level * information) ** 2, information, out=np.zeros_like(score), where=information > 0.0)
    weight = total - np.divide(np.sum(information**2, axis=0), total, out=np.zeros_like(total), where=total > 0.0)
    beyond = np.maximum(np.sum(squares, axis=0) - rules.LEAST_SCATTER**2 * (count - 1), 0.0)
    return np.sqrt(np.divide(beyond, weight, out=np.zeros_like(total), where=weight > 0.0)), count


def with_scatter(found: BlockStatistics, more: BlockStatistics) -> BlockStatistics:
    """Return the statistics with the scatter of more blocks, while the level is kept.

    The level must not follow a rig that wears.
    """
    return found._replace(scatter=more.scatter, dependence=more.dependence, freedom=more.freedom)


def _scatter(rest: Array, informed: NDArray[np.bool_], sections: int) -> Array:
    """Return the scale at which the limited scores have the variance of unlimited normal ones, shape (n,)."""
    prior = rules.LEARNT_BLOCKS
    count = np.sum(informed, axis=0)
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


class Change(NamedTuple):
    """A significant change: a sum that exceeds its bound.

    Attributes:
        quantity: number of the quantity.
        ratio: ratio of its sum to the bound.
        blocks: blocks since the likeliest onset.
        earliest: blocks since the earliest possible onset.
        latest: the same for the latest.
        size: departure since the likeliest onset.
        deviation: its standard deviation.
    """

    quantity: int
    ratio: float
    blocks: int
    earliest: int
    latest: int
    size: float
    deviation: float


def lengths() -> tuple[int, ...]:
    """Return the numbers of blocks over which scores are summed, each half as large again as the previous one."""
    out = [3]
    while out[-1] * 3 // 2 < rules.LONGEST_WATCH:
        out.append(out[-1] * 3 // 2)
    return tuple(out)


class ChangeTest:
    """Scores of the last blocks, and the test of their sums for a change.

    Attributes:
        healthy: statistics of a healthy rig's blocks.
        bound: bound on a sum, in standard deviations.
        largest: the largest of the latest sums, in standard deviations.
    """

    def __init__(self, healthy: BlockStatistics, hours: float, rising: Mask | None = None) -> None:
        """Start without blocks.

        Args:
            healthy: statistics of a healthy rig's blocks.
            hours: least mean time between false alarms [h].
            rising: quantities of which only a rise is a change, shape (n,).
        """
        self._rising = np.zeros(len(healthy.level), dtype=np.bool_) if rising is None else rising
        # Score, information and share of the blocks held, and after them the terms of their sums.
        self._rows = np.zeros((6, 2 * rules.LONGEST_WATCH, len(healthy.level)))
        self._first = self._end = 0
        self._hours = hours
        self.largest = 0.0
        self.learn(healthy)

    def learn(self, healthy: BlockStatistics) -> None:
        """Replace the statistics of the healthy rig and update the bound."""
        self.healthy = healthy
        tests = self._hours * HOUR / rules.BLOCK * len(healthy.level) * len(lengths())
        self.bound = float(-scipy.special.stdtrit(healthy.freedom, 0.5 / tests))
        self._varying = -scipy.special.stdtrit(np.maximum(healthy.varied - 1, 1), 0.5 / tests) * healthy.variation
        self._rows[3:, self._first : self._end] = self._terms(self.rows())

    @property
    def blocks(self) -> int:
        """Number of blocks held."""
        return self._end - self._first

    def restart(self) -> None:
        """Discard all blocks."""
        self._first = self._end = 0

    def add(self, score: Array, information: Array, share: Array) -> None:
        """Add a block.

        Args:
            score: of each quantity, shape (n,).
            information: of each quantity, 0 if the block holds none, shape (n,).
            share: change of the balance by one departure, as a fraction of its largest term, shape (n,).
        """
        if self._end == self._rows.shape[1]:
            kept = self._rows[:, self._first :].copy()
            self._first, self._end = 0, kept.shape[1]
            self._rows[:, : self._end] = kept
        raw = np.array([score, information, share])
        self._rows[:3, self._end], self._rows[3:, self._end] = raw, self._terms(raw)
        self._end += 1
        self._first = max(self._first, self._end - rules.LONGEST_WATCH)

    def rows(self) -> Array:
        """Return score, information and share of all blocks held, oldest first, shape (3, blocks, n)."""
        return self._rows[:3, self._first : self._end].copy()

    def change(self) -> Change | None:
        """Return the sum that exceeds its bound by the largest ratio; None while all could be chance."""
        self.largest = 0.0
        if self.blocks < lengths()[0]:
            return None
        blocks = np.array([n for n in lengths() if n <= self.blocks], dtype=np.intp)
        # Sums over the newest blocks, the fewest first, shape (sums, n).
        pieces = np.add.reduceat(self._rows[1:, : self._end], self._end - blocks[::-1], axis=1)
        information, share, whole, sums, squares = np.cumsum(pieces[:, ::-1], axis=1)
        informed = information > 0.0
        share = share / blocks[:, None]
        # If blocks scatter about their mean more than the healthy rig's, the deviation of their sum is enlarged accordingly.
        about = squares - np.divide(sums**2, information, out=np.zeros_like(share), where=informed)
        wider = np.maximum(about / (blocks - 1.0)[:, None], 1.0)
        noise = np.sqrt(wider * self.healthy.dependence * information)
        size = np.divide(whole * self.healthy.scatter, information, out=np.zeros_like(noise), where=informed)
        # Of a block, little counts against the noise: one alone is an incident. All of it counts against the allowed size.
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = 1.0 / (self.bound * np.hypot(noise / np.abs(sums), self._allowed(share) / np.abs(size)))
        counts = informed & (np.abs(size) * share >= rules.RELEVANT) & ~(self._rising & (sums < 0.0))
        ratio = np.where(counts & (size * sums > 0.0), ratio, 0.0)
        row, quantity = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        self.largest = float(ratio[row, quantity]) * self.bound
        if ratio[row, quantity] <= 1.0:
            return None
        newest = self._rows[[1, 4], self._first : self._end, quantity][:, ::-1]
        information, sums = np.cumsum(newest, axis=1)
        # A departure of opposite sign is another change, or the tolerance of a quantity of which only a rise counts.
        same = np.where(sums * sums[blocks[row] - 1] > 0.0, sums, 0.0)
        return self._since(int(quantity), float(ratio[row, quantity]), same, information)

    def _terms(self, rows: Array) -> Array:
        """Return the terms of the sums: scores by the root of information, the same of limited scores, and these squared.

        Scores are in units of the healthy scatter.

        Args:
            rows: score, information and share, shape (3, ..., n).

        Returns:
            Shape (3, ..., n).
        """
        score, information, _ = rows
        root = np.sqrt(information)
        unit = root * self.healthy.scatter
        rest = np.divide(score - self.healthy.level * information, unit, out=np.zeros_like(score), where=unit > 0.0)
        limited = np.clip(rest, -rules.MOST_SCORE, rules.MOST_SCORE)
        return np.array([rest * root, limited * root, limited * limited])

    def _allowed(self, share: Array) -> Array:
        """Return the standard deviation of a healthy rig's size, however many blocks are summed; infinite if it is unknown."""
        healthy = self.healthy
        # No model of a rig exceeds this accuracy, and its remainder on a healthy rig is no departure.
        inverse = np.divide(1.0, share, out=np.zeros_like(share), where=share > 0.0)
        remainder = np.minimum(self._varying, healthy.remainder * inverse) / self.bound
        tolerated = rules.TOLERANCE * inverse + remainder
        unsure = np.full_like(healthy.certainty, np.inf)
        np.divide(healthy.scatter**2 * healthy.dependence, healthy.certainty, out=unsure, where=healthy.certainty > 0.0)
        return np.sqrt(healthy.spread**2 + tolerated**2 + unsure)

    def _since(self, quantity: int, ratio: float, sums: Array, information: Array) -> Change:
        """Estimate the onset as the likeliest time of a step in the scores' mean."""
        gain = 0.5 * np.divide(sums**2, information, out=np.zeros_like(sums), where=information > 0.0)
        gain /= self.healthy.dependence[quantity]
        best = int(np.argmax(gain))
        possible = np.flatnonzero(gain > gain[best] - rules.ONSET_DROP)
        scatter = float(self.healthy.scatter[quantity])
        size = float(sums[best] / information[best]) * scatter
        deviation = scatter * float(np.sqrt(self.healthy.dependence[quantity] / information[best]))
        return Change(quantity, ratio, best + 1, int(possible[-1]) + 1, int(possible[0]) + 1, size, deviation)
