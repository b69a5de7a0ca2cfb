"""Periods along a signal from which the fit of an effect that repeats along it may start."""

from functools import partial

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.dependence import signals_along
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.record import VELOCITY
from ehls_ros.diagnosis.starts import main_channel
from ehls_ros.diagnosis.term_proposals import turns, waves_along, without_tail
from ehls_ros.physics.effects.base import Period


def period_left(evidence: Evidence, of: Period) -> float | None:
    """Return the period along a signal that predicts the main channel's residual best; None if none predicts enough of it.

    Args:
        evidence: the recording compared with the given model.
        of: the signal, and whether the residual follows the direction of motion.
    """
    channel, signals = main_channel(evidence.channels), signals_along(evidence.comparison(), evidence.rig)
    if of.signal not in signals or np.ptp(signals[of.signal]) == 0.0 or (of.turning and VELOCITY not in signals):
        return None
    values, target = signals[of.signal], without_tail(evidence.base.values[channel])
    if of.turning:
        _, direction = turns(evidence, channel, signals[VELOCITY])
        if direction is None:
            return None
        target = target * direction
    number, share = waves_along(partial(evidence.means, channel), values, evidence.half(channel)).strongest(target)
    return float(np.ptp(values)) / number if share >= rules.DEPENDS else None
