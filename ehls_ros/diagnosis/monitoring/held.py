"""Stretches in which static friction holds the piston, where the friction force is known only up to a constant.

While the piston is held, the friction state keeps the error it had when the piston stopped or the block began. The residuals
of many windows then share one error, so each stretch has a separate unknown constant force.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.stages import Channel
from ehls_ros.samples import Mask

FRICTION: Channel = "force"
"""Channel whose balance contains friction."""


class Held(NamedTuple):
    """The stretches of a recording in which the piston is held.

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
        """Return residuals, or their change, less the best-fitting constant force of each stretch, shape (n,)."""
        if not np.any(self.stretch):
            return values
        pull = np.bincount(self.stretch, self.weight * self.unit * values)
        norm = np.bincount(self.stretch, self.weight * self.unit**2)
        force = np.divide(pull, norm, out=np.zeros_like(pull), where=norm > 0.0)
        force[0] = 0.0
        left: Array = values - self.unit * force[self.stretch]
        return left


def held(evidence: Evidence, weight: Array, part: NDArray[np.intp]) -> Held:
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
    return Held(np.where(there, np.cumsum(begins), 0), 1.0 / evidence.floor[FRICTION], weight)


def _still(evidence: Evidence) -> Mask:
    """Return a mask of the samples up to which the piston has hardly moved for ``HELD_TIME``, shape (n,)."""
    position = evidence.comparison().motion(evidence.rig.effective()).position
    samples = max(1, round(rules.HELD_TIME / evidence.record.period))
    place = (samples - 1) // 2
    highest = scipy.ndimage.maximum_filter1d(position, samples, origin=place)
    lowest = scipy.ndimage.minimum_filter1d(position, samples, origin=place)
    still: Mask = highest - lowest < rules.HELD_TRAVEL * evidence.setup.presliding
    return still
