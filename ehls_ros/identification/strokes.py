"""Strokes missing for the identification of friction: slow and fast ones at steady velocity both ways, and presliding.

Without them the fit attributes inertia, spring and disturbance to friction, and its figures are meaningless.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.identification.motion import Motion
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask

SLOW, FAST = 2.0, 5.0
"""Velocities in Stribeck velocities: friction falls with the velocity below the first, and grows above the second."""

SWEPT = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Velocities of the requested strokes, in Stribeck velocities."""

MIN_BLOCKS = 20
"""Fewest blocks of steady sliding that identify the friction in a range of velocities."""

STEADY_TIME = 0.3
"""Time for which a stroke has to keep an about constant velocity, so that friction settles [s]."""

DISTURBED = 0.1
"""Disturbance force, as a fraction of sliding friction, above which the balance, which lacks it, is invalid."""

SINE_TRAVELS, MIN_AMPLITUDE = 1.7, 2e-4
"""Amplitude of the small sine in break-away travels, and its minimum [m]."""


class Missing(NamedTuple):
    """Motion missing in recordings.

    Attributes:
        descriptions: the missing parts in words, such as ``strokes slower than 4.1 mm/s backwards``.
        velocities: of the strokes that would supply them [m/s]; empty if no strokes are missing.
        sine: amplitude [m] and frequency [Hz] of the small sine that would show presliding; None if that was recorded.
    """

    descriptions: tuple[str, ...]
    velocities: tuple[float, ...] = ()
    sine: tuple[float, float] | None = None

    @property
    def requested(self) -> str:
        """The motion that would supply them, in words."""
        parts = []
        if self.velocities:
            low, high = (1e3 * v for v in (self.velocities[0], self.velocities[-1]))
            parts.append(f"strokes both ways at constant velocities from {low:.2g} to {high:.2g} mm/s")
        if self.sine is not None:
            parts.append(f"a sine of {1e3 * self.sine[0]:.2g} mm at {self.sine[1]:.2g} Hz")
        return " and ".join(parts)


def missing_strokes(motions: Sequence[Motion], steady: Sequence[Mask], rig: Rig, disturbance: float = 0.0) -> Missing:
    """Return the motion missing for the identification of a rig's friction.

    Args:
        motions: the recordings.
        steady: blocks of each that slide steadily.
        rig: the rig as known so far, for the relevant velocities and the limits.
        disturbance: standard deviation of the recorded disturbance force [N].
    """
    stribeck = float(getattr(rig.friction, "stribeck_velocity", math.inf))
    wide = [(m, s) for m, s in zip(motions, steady, strict=True) if not m.small]
    v = np.concatenate([m.velocity[s & _even(m)] for m, s in wide] or [np.empty(0)])
    fastest = 0.5 * rig.limits.velocity if math.isfinite(rig.limits.velocity) else math.inf
    if not math.isfinite(stribeck):
        stribeck = fastest / max(SWEPT) if math.isfinite(fastest) else 5e-3
    descriptions = []
    for way, name in ((1.0, "forwards"), (-1.0, "backwards")):
        for what, count in (
            (
                f"strokes slower than {1e3 * SLOW * stribeck:.2g} mm/s",
                np.count_nonzero((way * v > 0.0) & (way * v < SLOW * stribeck)),
            ),
            (f"strokes faster than {1e3 * FAST * stribeck:.2g} mm/s", np.count_nonzero(way * v > FAST * stribeck)),
        ):
            if count < MIN_BLOCKS:
                descriptions.append(f"{what} {name}")
    if disturbance > DISTURBED * rig.friction_level(math.inf):
        descriptions.append("strokes without a disturbance force")
    velocities = tuple(float(f"{s * stribeck:.3g}") for s in SWEPT if s * stribeck < fastest) if descriptions else ()
    travel = float(rig.friction_law.break_away(rig.friction))
    sine = None
    if travel > 0.0 and not any(m.small for m in motions):
        descriptions.append("presliding, a motion to and fro that hardly leaves its place")
        amplitude = max(SINE_TRAVELS * travel, MIN_AMPLITUDE)
        sine = (float(f"{amplitude:.2g}"), float(f"{stribeck / (2.0 * math.pi * amplitude):.2g}"))
    return Missing(tuple(descriptions), velocities, sine)


def _even(motion: Motion) -> Mask:
    """Return the blocks with a velocity clear of noise and nearly constant."""
    speed = np.abs(motion.velocity)
    even: Mask = (speed > 5.0 * motion.velocity_noise) & (STEADY_TIME * np.abs(motion.acceleration) < speed)
    return even
