"""Periods along a signal from which the fit of an effect that repeats along it may start."""

from functools import partial

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.dependence import explained_by, signals_along
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.record import VELOCITY
from ehls_ros.diagnosis.starts import main_channel
from ehls_ros.diagnosis.term_proposals import HARMONICS, TAIL, TURNING, WAVE_STEP, waves_along
from ehls_ros.physics.effects.base import Period

ALIKE = 0.9
"""Share of a shorter wave, over that of the best, from which the shorter one is taken."""


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
    waves, even = waves_along(means, values), evidence.block[channel] % 2 == 0
    shares = np.array([explained_by(columns, target, even) for columns in waves.columns])
    best = int(np.argmax(shares))
    if shares[best] < rules.DEPENDS:
        return None
    # A wave of twice or three times the length has the same one among its harmonics.
    for times in range(HARMONICS + 1, 1, -1):
        near = np.abs(waves.numbers - times * waves.numbers[best]) <= times * WAVE_STEP
        if np.any(near) and np.max(shares[near]) >= ALIKE * shares[best]:
            best = int(np.flatnonzero(near)[np.argmax(shares[near])])
            break
    return float(np.ptp(values) / waves.numbers[best])
