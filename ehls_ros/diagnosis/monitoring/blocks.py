"""Scores of blocks of a few seconds for each direction in which the rig may depart from its model.

The residuals of a block, in units of their noise floor, are projected on the change due to each departure. That gives a score
and an information for each direction. Both are additive over blocks, and their ratio is the departure's size, fitted alone.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, part_of
from ehls_ros.diagnosis.loss import weights
from ehls_ros.diagnosis.monitoring.directions import Direction, changes
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.samples import Mask

FRICTION: Channel = "force"
"""Channel whose balance contains friction."""


class Scores(NamedTuple):
    """Scores of a block for every quantity: the directions, and after them the power of each channel's residual.

    Attributes:
        score: of each quantity, divided by its variance due to the sensors' noise, shape (n,).
        information: likewise; 0 if the block holds none, shape (n,).
        share: rms of the change by each direction, as a fraction of the largest term of its balance; 1 for a power, shape (n,).
        normal: products of the changes by any two of the tracked directions, shape (tracked, tracked).
        pull: products of these changes with the residuals, with the sign of the departure, shape (tracked,).
    """

    score: Array
    information: Array
    share: Array
    normal: Array = np.zeros((0, 0))
    pull: Array = np.zeros(0)


class HeldStretches(NamedTuple):
    """Stretches in which static friction holds the piston, so that the friction force is known only up to a constant.

    While the piston is held, the friction state keeps the error it had when the piston stopped or the block began. The
    residuals of many windows then share one error, so each stretch has a separate unknown constant force.

    Attributes:
        stretch: number of the stretch in which each usable window of the force balance lies; 0 where the piston slides,
            shape (n,).
        unit: a force of 1 N in units of the noise floor, shape (n,).
        weight: weight of each window, shape (n,).
    """

    stretch: NDArray[np.intp]
    unit: Array
    weight: Array

    def without(self, values: Array) -> Array:
        """Return residuals, or their changes, less the best-fitting constant force of each stretch, shape (..., n)."""
        if not np.any(self.stretch):
            return values
        inside = (self.stretch[:, np.newaxis] == np.arange(1, np.max(self.stretch) + 1)).astype(np.float64)
        pull = (values * (self.weight * self.unit)) @ inside
        norm = (self.weight * self.unit**2) @ inside
        force = np.divide(pull, norm, out=np.zeros_like(pull), where=norm > 0.0)
        left: Array = values - self.unit * (force @ inside.T)
        return left


def held_stretches(evidence: Evidence, weight: Array, part: NDArray[np.intp]) -> HeldStretches:
    """Find the stretches in which the piston is held.

    Args:
        evidence: a recording compared with the model.
        weight: weight of each usable window of the force balance, shape (n,).
        part: part of the recording in which each window lies, shape (n,); stretches do not extend from one part to the next.
    """
    window, still = evidence.setup.window_of(FRICTION), _still(evidence)
    middle = window.starts(len(still))[evidence.masks[FRICTION]] + window.weights.size // 2
    there = still[np.minimum(middle, len(still) - 1)]
    begins = there & ((np.diff(there.astype(np.intp), prepend=0) == 1) | (np.diff(part, prepend=-1) != 0))
    return HeldStretches(np.where(there, np.cumsum(begins), 0), 1.0 / evidence.floor[FRICTION], weight)


def _still(evidence: Evidence) -> Mask:
    """Return a mask of the samples up to which the piston has hardly moved for ``HELD_TIME``, shape (n,)."""
    position = evidence.comparison().motion(evidence.rig.effective()).position
    samples = max(1, round(rules.HELD_TIME / evidence.record.period))
    place = (samples - 1) // 2
    highest = scipy.ndimage.maximum_filter1d(position, samples, origin=place)
    lowest = scipy.ndimage.minimum_filter1d(position, samples, origin=place)
    still: Mask = highest - lowest < rules.HELD_TRAVEL * evidence.setup.presliding
    return still


def informative(evidence: Evidence) -> Evidence:
    """Return the informative part of the evidence: channels well above their noise, or none if the piston hardly moves.

    In other channels, noise biases the factors of gains; and the force that holds a stuck piston depends on unmeasured states.

    Args:
        evidence: some blocks compared with the model.
    """
    kept = {}
    moves = evidence.travel >= rules.SLIDING * evidence.setup.presliding
    for c in evidence.channels:
        floor = math.sqrt(float(np.mean(evidence.floor[c] ** 2)))
        if moves and evidence.sizes[c] >= rules.MONITOR_SIGNAL * floor:
            kept[c] = np.ones(len(evidence.floor[c]), dtype=np.bool_)
    return part_of(evidence, kept)


def scores(
    evidence: Evidence, directions: Sequence[Direction], tracked: Sequence[int], begins: Sequence[float]
) -> list[Scores]:
    """Score the residuals of blocks against the change due to each departure.

    Args:
        evidence: successive blocks and the lead before them, compared with the model.
        directions: the departures.
        tracked: numbers of the directions that are fitted jointly.
        begins: time at which each block begins [s].

    Returns:
        The scores of each block.
    """
    comparison, base = evidence.comparison(), evidence.base
    part = {c: np.searchsorted(begins, evidence.times[c], side="right") for c in evidence.channels}
    counted = {c: weights(base.values[c]) for c in evidence.channels}
    holding = held_stretches(evidence, counted[FRICTION], part[FRICTION]) if FRICTION in evidence.channels else None
    rest = dict(base.values) if holding is None else {**base.values, FRICTION: holding.without(base.values[FRICTION])}
    blocks, count = len(begins) + 1, len(directions)
    score, information, share = (np.zeros((blocks, count)) for _ in range(3))
    noise = np.zeros((len(evidence.added), blocks, count))
    normal = np.zeros((blocks, len(tracked), len(tracked)))
    place = {number: row for row, number in enumerate(tracked)}
    moved: dict[Channel, dict[int, Array]] = {c: {} for c in evidence.channels}
    for number, direction in enumerate(directions):
        for c, change in changes(comparison, evidence, direction).items():
            moved[c][number] = change
    for c, by_number in moved.items():
        if not by_number:
            continue
        numbers = list(by_number)
        rows = np.array(list(by_number.values()))
        rows = holding.without(rows) if holding is not None and c == FRICTION else rows
        own = [row for row, number in enumerate(numbers) if number in place]
        where = np.ix_([place[numbers[row]] for row in own], [place[numbers[row]] for row in own])
        added = np.array([more[c] for more in evidence.added]).reshape(len(evidence.added), -1)
        ends = np.searchsorted(part[c], np.arange(blocks + 1))
        for block in range(1, blocks):
            here = slice(ends[block], ends[block + 1])
            change, weight = rows[:, here], counted[c][here]
            score[block, numbers] -= change @ (weight * rest[c][here])
            information[block, numbers] += change**2 @ weight
            noise[:, block, numbers] += added[:, here] @ change.T
            squares = change**2 @ evidence.floor[c][here] ** 2 / max(len(weight), 1)
            size = np.sqrt(squares) / max(evidence.sizes[c], 1e-300)
            share[block, numbers] = np.maximum(share[block, numbers], size)
            normal[block][where] += (change[own] * weight) @ change[own].T
    out = []
    for block in range(1, blocks):
        power, certainty = _power({c: e[part[c] == block] for c, e in rest.items()})
        ratio = _variance_ratio(noise[:, block], information[block])
        out.append(
            Scores(
                np.concatenate([score[block] / ratio, power * certainty]),
                np.concatenate([information[block] / ratio, certainty]),
                np.concatenate([share[block], np.ones(len(power))]),
                normal[block],
                score[block, list(tracked)],
            )
        )
    return out


def _variance_ratio(noise: Array, information: Array) -> Array:
    """Return the ratio of each score's variance to that of independent windows, at least 1.

    If the piston hardly slides, noise corrupts the friction model's state for many windows in succession.

    Args:
        noise: change of the scores by each realisation of the sensors' noise, shape (realisations, directions).
        information: shape (directions,).
    """
    ratio = np.divide(noise**2, information, out=np.ones_like(noise), where=information > 0.0)
    expected = rules.MONITOR_REALISATIONS
    return np.maximum((expected + np.sum(ratio, axis=0)) / (expected + len(noise)), 1.0)


def _power(base: Mapping[Channel, Array]) -> tuple[Array, Array]:
    """Return the logarithm of each channel's mean square, and its information for normal, independent windows."""
    squares = {c: float(np.mean(np.minimum(e**2, rules.MONITOR_SQUARE))) for c, e in base.items() if len(e)}
    power = np.array([math.log(max(squares.get(c, 1.0), 1e-6)) for c in CHANNELS])
    return power, np.array([0.5 * len(base[c]) if c in squares else 0.0 for c in CHANNELS])
