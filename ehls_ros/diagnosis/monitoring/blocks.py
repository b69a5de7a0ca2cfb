"""What a block of a few seconds says of each direction in which the rig may depart from its model.

The residuals of the model along a block, in units of their noise floor, are weighed against the change that each departure
makes. That gives a score and an information for each direction, and both add up over blocks: their ratio is the departure's
size, as fitted alone.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence, Residuals
from ehls_ros.diagnosis.loss import weights
from ehls_ros.diagnosis.monitoring.directions import Direction, changes
from ehls_ros.diagnosis.stages import CHANNELS


class Scores(NamedTuple):
    """What a block says of every quantity: the directions, and after them the power of each channel's residual.

    Attributes:
        score: of each quantity, shape (n,).
        information: of each quantity; 0 where the block tells nothing, shape (n,).
        share: rms of the change by each direction, as a fraction of the largest term of its balance; 1 for a power, shape (n,).
        normal: products of the changes by any two of the tracked directions, shape (tracked, tracked).
    """

    score: Array
    information: Array
    share: Array
    normal: Array


def scores(evidence: Evidence, directions: Sequence[Direction], tracked: Sequence[int] = ()) -> Scores:
    """Weigh a block's residuals against what each departure would change.

    Args:
        evidence: the block compared with the model.
        directions: the departures.
        tracked: numbers of the directions that are fitted together.
    """
    comparison, base = evidence.comparison(), evidence.base
    counted = {c: weights(base.values[c]) for c in evidence.channels}
    pull = {c: counted[c] * base.values[c] for c in evidence.channels}
    score, information, share = (np.zeros(len(directions)) for _ in range(3))
    place = {number: row for row, number in enumerate(tracked)}
    kept = {c: np.zeros((len(tracked), len(base.values[c]))) for c in evidence.channels}
    for number, direction in enumerate(directions):
        for c, change in changes(comparison, evidence, direction).items():
            score[number] -= np.einsum("i,i", change, pull[c])
            information[number] += np.einsum("i,i,i", change, change, counted[c])
            moved = change * evidence.floor[c]
            size = math.sqrt(float(np.einsum("i,i", moved, moved)) / len(moved)) / max(evidence.sizes[c], 1e-300)
            share[number] = max(share[number], size)
            if number in place:
                kept[c][place[number]] = change
    normal = np.zeros((len(tracked), len(tracked)))
    for c, moves in kept.items():
        normal += np.einsum("ik,jk,k->ij", moves, moves, counted[c])
    power, certainty = _power(base)
    return Scores(
        np.concatenate([score, power * certainty]),
        np.concatenate([information, certainty]),
        np.concatenate([share, np.ones(len(power))]),
        normal,
    )


def _power(base: Residuals) -> tuple[Array, Array]:
    """Return the logarithm of each channel's mean square and its information, were its windows normal and independent."""
    squares = {c: float(np.mean(np.minimum(e**2, rules.MONITOR_SQUARE))) for c, e in base.values.items()}
    power = np.array([math.log(max(squares.get(c, 1.0), 1e-6)) for c in CHANNELS])
    return power, np.array([0.5 * len(base.values[c]) if c in base.values else 0.0 for c in CHANNELS])
