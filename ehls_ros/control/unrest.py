"""How restless the external force is: the noise of its second derivative, from what it does.

A filter that expects a quiet force averages the sensors' noise away; one that expects a restless force follows it. Which of
the two it meets is seen in the estimated rate of that part of the force which nobody foresaw. A motion of angular frequency
w whose rate has the rms R has a third derivative of rms w^2 R, which as white noise has a spectral density of about
(w^2 R)^2 / w: its root is proportional to R. After a reversal of the piston's motion the friction is in doubt until its
elements slip again, and the filter takes the difference for an external force.
"""

import math
from typing import NamedTuple

from ehls_ros.arrays import Array, kernel

MEAN_SQUARE, DIRECTION, TRAVEL, PARTS = range(4)
"""Where an unrest holds the mean square of the rate [N^2/s^2], the direction of motion and the travel since it reversed [m];
and its length."""


SUDDEN = 0.25
"""Least mean square of the rate, as a fraction of its present square."""


class Habits(NamedTuple):
    """What is expected of the external force.

    Attributes:
        least_noise: noise of its second derivative while it is at rest [N/s^5/2].
        rate_noise: that noise over the rms of its rate [1/s^3/2].
        memory: time constant of that mean square [s].
        reversal_factor: factor of the noise after a reversal of the piston's motion.
        reversal_travel: travel for which it holds [m].
    """

    least_noise: float
    rate_noise: float
    memory: float
    reversal_factor: float
    reversal_travel: float


@kernel
def external_noise(rate: float, velocity: float, period: float, habits: Habits, unrest: Array) -> float:
    """Return the noise of the external force's second derivative [N/s^5/2], and update what it rests on.

    Args:
        rate: estimated rate of the force that nobody foresaw [N/s].
        velocity: estimated velocity of the piston [m/s].
        period: time since the last call [s].
        habits: what is expected of the force.
        unrest: shape (:data:`PARTS`,), zero at the start; changed in place.
    """
    unrest[MEAN_SQUARE] += -math.expm1(-period / habits.memory) * (rate * rate - unrest[MEAN_SQUARE])
    # No sine's square exceeds twice its mean: one that exceeds it four times is a force that has changed its habits.
    unrest[MEAN_SQUARE] = max(unrest[MEAN_SQUARE], SUDDEN * rate * rate)
    direction = 1.0 if velocity > 0.0 else -1.0
    if direction != unrest[DIRECTION]:
        unrest[DIRECTION], unrest[TRAVEL] = direction, 0.0
    unrest[TRAVEL] += abs(velocity) * period
    noise = math.hypot(habits.least_noise, habits.rate_noise * math.sqrt(unrest[MEAN_SQUARE]))
    return noise * (habits.reversal_factor if unrest[TRAVEL] < habits.reversal_travel else 1.0)
