"""Detection of a failed specimen: its force falls short of the stiffness learnt before.

The specimen's force is the measured one less the inertia of the moving mass, F - m a, so that the stiffness does not depend on
the frequency of the test. Of it, stiffness and damping, friction included, are learnt by recursive least squares with a memory
of :data:`MEMORY` samples. Only samples count between which the piston has moved, by more than the noise of its sensor and a
small part of the usual motion; so at standstill both are kept. The force falls short if it lacks more than a given fraction of
the change that the stiffness predicts, more than three times the usual scatter (noise and friction), and more than
:data:`LEAST` of the force limit. A load cell that has lost its signal shows in the same way.

Where the force does not follow the position, as against an actuator that moves by itself, the scatter exceeds
:data:`MOST_SCATTER` of the motion and nothing is judged. By coincidence it may follow for a while; so the check is for passive
specimens only.
"""

import math

from ehls_ros.physics.parameters import Sensor

MEMORY = 1000
"""Samples over which the line is learnt, and before the first judgement."""

MOTION = 0.02
"""Least motion between two samples learnt, as a fraction of the standard deviation of the position."""

NOISE = 4.0
"""Least motion between two samples learnt, in standard deviations of the sensor's noise."""

MOST_SCATTER = 0.3
"""Largest standard deviation about the line, as a fraction of that of the predicted force."""

SCATTERS = 3.0
"""Permitted deviation from the line, in standard deviations about it."""

LEAST = 0.1
"""Least lack of force, as a fraction of the force limit: friction that reverses is not taken for a lack."""


class Specimen:
    """Stiffness of a specimen, learnt while it is loaded.

    Attributes:
        stiffness: slope of the line [N/m]; 0 before the first sample.
    """

    def __init__(self, mass: float, force_limit: float, sensor: Sensor) -> None:
        """Start without samples.

        Args:
            mass: that moves between actuator and specimen [kg].
            force_limit: of the rig [N].
            sensor: of the position.
        """
        self._mass, self._least = mass, LEAST * force_limit
        self._scatter = NOISE * sensor.noise_std + sensor.resolution
        self.forget()

    def forget(self) -> None:
        """Forget the specimen."""
        self.stiffness = 0.0
        self._last = (math.nan, math.nan, math.nan)
        self._learnt_at = -math.inf
        self._count = self._followed = 0
        self._position = self._force = self._spread = self._product = self._residual = 0.0
        self._damping = self._speeds = self._power = 0.0

    def look(self, position: float, velocity: float, force: float, elapsed: float, drop: float) -> tuple[bool, float]:
        """Return whether the force falls short, and the force over the predicted one [1].

        Args:
            position: of the piston [m].
            velocity: of the piston [m/s]; NaN if unknown, then it follows from the position.
            force: driving force [N].
            elapsed: time since the last sample [s].
            drop: fraction of the predicted change of force that may be missing.
        """
        before, speed, pull = self._last
        if math.isnan(velocity) and elapsed > 0.0:
            velocity = (position - before) / elapsed
        self._last = position, velocity, force
        # Between two samples, where their difference of velocities is the acceleration.
        x, v = 0.5 * (position + before), 0.5 * (velocity + speed)
        f = 0.5 * (force + pull) - self._mass * (velocity - speed) / elapsed if elapsed > 0.0 else math.nan
        if not math.isfinite(x + v + f):
            return False, math.nan
        dx, df = x - self._position, f - self._force - self._damping * v
        predicted = self.stiffness * dx
        lack = math.copysign(1.0, dx) * (predicted - df)
        usual = SCATTERS * math.sqrt(self._residual)
        short = self._is_known and lack > max(drop * abs(predicted), usual, self._least)
        if not short:
            self._learn(x, v, f)
        return short, df / predicted if predicted else math.nan

    @property
    def _is_known(self) -> bool:
        return self._followed >= MEMORY

    def _learn(self, x: float, v: float, f: float) -> None:
        if abs(x - self._learnt_at) <= max(MOTION * math.sqrt(self._spread), self._scatter):
            return
        self._learnt_at = x
        self._count = min(self._count + 1, MEMORY)
        weight = 1.0 / self._count
        dx, df = x - self._position, f - self._force
        self._position += weight * dx
        self._force += weight * df
        self._spread += weight * (dx * dx - self._spread)
        self._product += weight * (dx * df - self._product)
        self.stiffness = self._product / self._spread if self._spread > 0.0 else 0.0
        # Over load cycles the velocity is not correlated with the position.
        self._speeds += weight * (v * v - self._speeds)
        self._power += weight * (v * (df - self.stiffness * dx) - self._power)
        self._damping = max(self._power / self._speeds, 0.0) if self._speeds > 0.0 else 0.0
        error = df - self.stiffness * dx - self._damping * v
        self._residual += weight * (error * error - self._residual)
        follows = self.stiffness > 0.0 and self._residual < (MOST_SCATTER * self.stiffness) ** 2 * self._spread
        loaded = self.stiffness * math.sqrt(self._spread) > 0.5 * self._least
        self._followed = self._followed + 1 if follows and loaded else 0
