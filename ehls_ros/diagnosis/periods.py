"""Periods along a signal from which the fit of an effect that repeats along it may start."""

from functools import partial

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.dependence import signals_along
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.record import VELOCITY
from ehls_ros.diagnosis.starts import main_channel
from ehls_ros.diagnosis.term_proposals import TAIL, TURNING, waves_along
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
    values, means = signals[of.signal], partial(evidence.means, channel)
    e = evidence.base.values[channel]
    limit = float(np.quantile(np.abs(e), TAIL))
    target = np.clip(e, -limit, limit)
    if of.turning:
        speed = float(np.sqrt(np.mean(signals[VELOCITY] ** 2)))
        target = target * np.tanh(means(signals[VELOCITY]) / max(TURNING * speed, 1e-300))
    number, share = waves_along(means, values).strongest(target, evidence.block[channel] % 2 == 0)
    return float(np.ptp(values)) / number if share >= rules.DEPENDS else None
