"""Estimate the unrest of the external force: the noise of its second derivative, from its observed rate.

A filter that expects a quiet force averages the sensors' noise; one that expects a restless force follows the force. The unrest
is estimated from the rate of the part of the force that is not foreseen. A motion of angular frequency w whose rate has the rms
R has a third derivative of rms w^2 R, which as white noise has a spectral density of about (w^2 R)^2 / w: its root is
proportional to R. After a reversal of the piston's motion the friction is uncertain until its elements slip again, and the
filter takes the difference for an external force.
"""

import math
from typing import NamedTuple

from ehls_ros.arrays import Array, kernel

MEAN_SQUARE, DIRECTION, TRAVEL, PARTS = range(4)
"""Indices of an unrest: mean square of the rate [N^2/s^2], direction of motion, and travel since its reversal [m]; and its
length."""


SUDDEN = 0.25
"""Least mean square of the rate, as a fraction of its present square."""


class Habits(NamedTuple):
    """Assumptions on the external force.

    Attributes:
        least_noise: noise of its second derivative at rest [N/s^5/2].
        rate_noise: ratio of that noise to the rms of its rate [1/s^3/2].
        memory: time constant of the mean square [s].
        reversal_factor: factor on the noise after a reversal of the piston's motion.
        reversal_travel: travel over which the factor applies [m].
    """

    least_noise: float
    rate_noise: float
    memory: float
    reversal_factor: float
    reversal_travel: float


@kernel
def external_noise(rate: float, velocity: float, period: float, habits: Habits, unrest: Array) -> float:
    """Return the noise of the external force's second derivative [N/s^5/2], and update the unrest.

    Args:
        rate: estimated rate of the force that is not foreseen [N/s].
        velocity: estimated velocity of the piston [m/s].
        period: time since the last call [s].
        habits: assumptions on the force.
        unrest: shape (:data:`PARTS`,), zero at the start; changed in place.
    """
    unrest[MEAN_SQUARE] += -math.expm1(-period / habits.memory) * (rate * rate - unrest[MEAN_SQUARE])
    # A sine's square is at most twice its mean; a square above four times the mean indicates a change of the force.
    unrest[MEAN_SQUARE] = max(unrest[MEAN_SQUARE], SUDDEN * rate * rate)
    direction = 1.0 if velocity > 0.0 else -1.0
    if direction != unrest[DIRECTION]:
        unrest[DIRECTION], unrest[TRAVEL] = direction, 0.0
    unrest[TRAVEL] += abs(velocity) * period
    noise = math.hypot(habits.least_noise, habits.rate_noise * math.sqrt(unrest[MEAN_SQUARE]))
    return noise * (habits.reversal_factor if unrest[TRAVEL] < habits.reversal_travel else 1.0)
