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
from ehls_ros.diagnosis.evidence import Evidence, Residuals, part_of
from ehls_ros.diagnosis.loss import weights
from ehls_ros.diagnosis.monitoring.directions import Direction, changes
from ehls_ros.diagnosis.monitoring.sliding import has_slid
from ehls_ros.diagnosis.stages import CHANNELS

WHOLE = 1e-9
"""Rounding of a mean over a window of samples that are all good."""


class Scores(NamedTuple):
    """What a block says of every quantity: the directions, and after them the power of each channel's residual.

    Attributes:
        score: of each quantity, by the variance that the sensors' noise gives it, shape (n,).
        information: likewise; 0 where the block tells nothing, shape (n,).
        share: rms of the change by each direction, as a fraction of the largest term of its balance; 1 for a power, shape (n,).
        normal: products of the changes by any two of the tracked directions, shape (tracked, tracked).
    """

    score: Array
    information: Array
    share: Array
    normal: Array


def telling(evidence: Evidence) -> Evidence:
    """Return what of a block tells of the rig: channels that stand out of their noise, and friction once its state is known.

    Args:
        evidence: the block compared with the model.
    """
    kept = {}
    for c in evidence.channels:
        floor = math.sqrt(float(np.mean(evidence.floor[c] ** 2)))
        if evidence.sizes[c] < rules.MONITOR_SIGNAL * floor:
            continue
        kept[c] = np.ones(len(evidence.floor[c]), dtype=np.bool_)
        if c == "force":
            motion = evidence.comparison().motion(evidence.rig.effective())
            slid = has_slid(motion.position, evidence.setup.presliding, evidence.record.period)
            kept[c] = evidence.means(c, slid.astype(np.float64)) > 1.0 - WHOLE
    return part_of(evidence, kept)


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
    noise = np.zeros((len(evidence.added), len(directions)))
    place = {number: row for row, number in enumerate(tracked)}
    kept = {c: np.zeros((len(tracked), len(base.values[c]))) for c in evidence.channels}
    for number, direction in enumerate(directions):
        for c, change in changes(comparison, evidence, direction).items():
            score[number] -= np.einsum("i,i", change, pull[c])
            information[number] += np.einsum("i,i,i", change, change, counted[c])
            for realisation, added in enumerate(evidence.added):
                noise[realisation, number] += np.einsum("i,i", change, added[c])
            moved = change * evidence.floor[c]
            size = math.sqrt(float(np.einsum("i,i", moved, moved)) / len(moved)) / max(evidence.sizes[c], 1e-300)
            share[number] = max(share[number], size)
            if number in place:
                kept[c][place[number]] = change
    normal = np.zeros((len(tracked), len(tracked)))
    for c, moves in kept.items():
        normal += np.einsum("ik,jk,k->ij", moves, moves, counted[c])
    power, certainty = _power(base)
    doubt = _doubt(noise, information)
    return Scores(
        np.concatenate([score / doubt, power * certainty]),
        np.concatenate([information / doubt, certainty]),
        np.concatenate([share, np.ones(len(power))]),
        normal,
    )


def _doubt(noise: Array, information: Array) -> Array:
    """Return by how much the variance of each score exceeds that of independent windows, at least 1.

    Where the piston hardly slides, noise makes the friction model's state wrong for many windows on end.

    Args:
        noise: what realisations of the sensors' noise add to the scores, shape (realisations, directions).
        information: shape (directions,).
    """
    ratio = np.divide(noise**2, information, out=np.ones_like(noise), where=information > 0.0)
    expected = rules.MONITOR_REALISATIONS
    return np.maximum((expected + np.sum(ratio, axis=0)) / (expected + len(noise)), 1.0)


def _power(base: Residuals) -> tuple[Array, Array]:
    """Return the logarithm of each channel's mean square and its information, were its windows normal and independent."""
    squares = {c: float(np.mean(np.minimum(e**2, rules.MONITOR_SQUARE))) for c, e in base.values.items()}
    power = np.array([math.log(max(squares.get(c, 1.0), 1e-6)) for c in CHANNELS])
    return power, np.array([0.5 * len(base.values[c]) if c in base.values else 0.0 for c in CHANNELS])
