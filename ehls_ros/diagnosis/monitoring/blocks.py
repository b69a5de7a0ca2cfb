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
from ehls_ros.diagnosis.monitoring.directions import Direction
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.physics.rig import Rig


class Scores(NamedTuple):
    """What a block says of every quantity: the directions, and after them the power of each channel's residual.

    Attributes:
        score: of each quantity, shape (n,).
        information: of each quantity; 0 where the block tells nothing, shape (n,).
        share: rms of the change by each direction, as a fraction of the largest term of its balance; 1 for a power, shape (n,).
        normal: products of the changes by any two directions, shape (directions, directions).
    """

    score: Array
    information: Array
    share: Array
    normal: Array


def scores(evidence: Evidence, directions: Sequence[Direction], rig: Rig | None = None) -> Scores:
    """Weigh a block's residuals against what each departure would change.

    Args:
        evidence: the block compared with the model.
        directions: the departures.
        rig: the model; that of the evidence where nothing is said.
    """
    rig = evidence.rig if rig is None else rig
    comparison = evidence.comparison()
    base = evidence.base if rig is evidence.rig else evidence.residuals(comparison, rig)
    counted = {c: weights(base.values[c]) for c in evidence.channels}
    count = len(directions)
    changes: dict[Channel, Array] = {c: np.zeros((count, len(base.values[c]))) for c in evidence.channels}
    for index, direction in enumerate(directions):
        other = evidence.residuals(comparison, direction.rig(rig), base)
        for c in evidence.channels:
            changes[c][index] = other.values[c] - base.values[c]
    score, normal, share = np.zeros(count), np.zeros((count, count)), np.zeros(count)
    for c in evidence.channels:
        change = changes[c]
        weighed = change * counted[c]
        score -= weighed @ base.values[c]
        normal += weighed @ change.T
        size = np.sqrt(np.mean((change * evidence.floor[c]) ** 2, axis=1)) / max(evidence.sizes[c], 1e-300)
        share = np.maximum(share, size)
    power, certainty = _power(base)
    return Scores(
        np.concatenate([score, power * certainty]),
        np.concatenate([np.diag(normal), certainty]),
        np.concatenate([share, np.ones(len(power))]),
        normal,
    )


def _power(base: Residuals) -> tuple[Array, Array]:
    """Return the logarithm of each channel's mean square and its information, were its windows normal and independent."""
    squares = {c: float(np.mean(np.minimum(e**2, rules.MONITOR_SQUARE))) for c, e in base.values.items()}
    power = np.array([math.log(max(squares.get(c, 1.0), 1e-6)) for c in CHANNELS])
    return power, np.array([0.5 * len(base.values[c]) if c in base.values else 0.0 for c in CHANNELS])
