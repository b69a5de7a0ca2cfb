"""Scores of blocks of a few seconds for each direction in which the rig may depart from its model.

The residuals of a block, in units of their noise floor, are projected on the change due to each departure. That gives a score
and an information for each direction. Both are additive over blocks, and their ratio is the departure's size, fitted alone.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, part_of
from ehls_ros.diagnosis.loss import weights
from ehls_ros.diagnosis.monitoring.directions import Direction, changes
from ehls_ros.diagnosis.monitoring.held import FRICTION, held
from ehls_ros.diagnosis.stages import CHANNELS, Channel


class Scores(NamedTuple):
    """Scores of a block for every quantity: the directions, and after them the power of each channel's residual.

    Attributes:
        score: of each quantity, divided by its variance due to the sensors' noise, shape (n,).
        information: likewise; 0 if the block holds none, shape (n,).
        share: rms of the change by each direction, as a fraction of the largest term of its balance; 1 for a power, shape (n,).
        normal: products of the changes by any two of the tracked directions, shape (tracked, tracked).
    """

    score: Array
    information: Array
    share: Array
    normal: Array


def telling(evidence: Evidence) -> Evidence:
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
    holding = held(evidence, counted[FRICTION], part[FRICTION]) if FRICTION in evidence.channels else None
    rest = dict(base.values) if holding is None else {**base.values, FRICTION: holding.without(base.values[FRICTION])}
    pull = {c: counted[c] * rest[c] for c in evidence.channels}
    blocks, count = len(begins) + 1, len(directions)
    score, information, share = (np.zeros((blocks, count)) for _ in range(3))
    noise = np.zeros((len(evidence.added), blocks, count))
    normal = np.zeros((blocks, len(tracked), len(tracked)))
    windows = {c: np.maximum(np.bincount(part[c], minlength=blocks), 1) for c in evidence.channels}
    place = {number: row for row, number in enumerate(tracked)}
    kept = {c: np.zeros((len(tracked), len(base.values[c]))) for c in evidence.channels}

    def summed(channel: Channel, values: Array) -> Array:
        sums: Array = np.bincount(part[channel], values, blocks).astype(np.float64)
        return sums

    for number, direction in enumerate(directions):
        for c, moved in changes(comparison, evidence, direction).items():
            change = holding.without(moved) if holding is not None and c == FRICTION else moved
            score[:, number] -= summed(c, change * pull[c])
            information[:, number] += summed(c, change * change * counted[c])
            for realisation, added in enumerate(evidence.added):
                noise[realisation, :, number] += summed(c, change * added[c])
            size = np.sqrt(summed(c, (change * evidence.floor[c]) ** 2) / windows[c]) / max(evidence.sizes[c], 1e-300)
            share[:, number] = np.maximum(share[:, number], size)
            if number in place:
                kept[c][place[number]] = change
    for c, moves in kept.items():
        for block in range(1, blocks):
            here = part[c] == block
            normal[block] += np.einsum("ik,jk,k->ij", moves[:, here], moves[:, here], counted[c][here])
    out = []
    for block in range(1, blocks):
        power, certainty = _power({c: e[part[c] == block] for c, e in rest.items()})
        doubt = _doubt(noise[:, block], information[block])
        out.append(
            Scores(
                np.concatenate([score[block] / doubt, power * certainty]),
                np.concatenate([information[block] / doubt, certainty]),
                np.concatenate([share[block], np.ones(len(power))]),
                normal[block],
            )
        )
    return out


def _doubt(noise: Array, information: Array) -> Array:
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
