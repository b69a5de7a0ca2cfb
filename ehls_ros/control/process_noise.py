"""Process noise of the external force, adapted to the activity of that force.

A filter that expects a quiet force averages the sensors' noise. One that expects an active force follows the force. The
activity is the mean square of the rate of the force that is not foreseen. A motion of angular frequency w whose rate has the
rms R has a third derivative of rms w^2 R. As white noise this has a spectral density of about (w^2 R)^2 / w, whose root is
proportional to R. After a reversal of the piston's motion the friction is uncertain until its elements slip again. The filter
takes the difference for an external force.
"""

import math
from typing import NamedTuple

from ehls_ros.arrays import Array, kernel

MEAN_SQUARE, DIRECTION, TRAVEL, SIZE = range(4)
"""Indices of an activity: mean square of the rate [N^2/s^2], direction of motion, and travel since its reversal [m]; and its
length."""

MIN_MEAN_SQUARE = 0.25
"""Lower bound of the mean square of the rate, as a fraction of its present square."""


class ProcessNoise(NamedTuple):
    """Relation between activity and process noise.

    Attributes:
        min_noise: noise of the force's second derivative at rest [N/s^5/2].
        rate_noise: ratio of that noise to the rms of its rate [1/s^3/2].
        time_constant: time constant of the mean square [s].
        reversal_factor: factor on the noise after a reversal of the piston's motion.
        reversal_travel: travel over which the factor applies [m].
    """

    min_noise: float
    rate_noise: float
    time_constant: float
    reversal_factor: float
    reversal_travel: float


@kernel
def external_noise(rate: float, velocity: float, period: float, p: ProcessNoise, activity: Array) -> float:
    """Return the noise of the external force's second derivative [N/s^5/2], and update the activity.

    Args:
        rate: estimated rate of the force that is not foreseen [N/s].
        velocity: estimated velocity of the piston [m/s].
        period: time since the last call [s].
        p: relation between activity and noise.
        activity: shape (:data:`SIZE`,), zero at the start; changed in place.
    """
    activity[MEAN_SQUARE] += -math.expm1(-period / p.time_constant) * (rate * rate - activity[MEAN_SQUARE])
    # A sine's square is at most twice its mean; a square above four times the mean indicates a change of the force.
    activity[MEAN_SQUARE] = max(activity[MEAN_SQUARE], MIN_MEAN_SQUARE * rate * rate)
    direction = 1.0 if velocity > 0.0 else -1.0
    if direction != activity[DIRECTION]:
        activity[DIRECTION], activity[TRAVEL] = direction, 0.0
    activity[TRAVEL] += abs(velocity) * period
    noise = math.hypot(p.min_noise, p.rate_noise * math.sqrt(activity[MEAN_SQUARE]))
    return noise * (p.reversal_factor if activity[TRAVEL] < p.reversal_travel else 1.0)
