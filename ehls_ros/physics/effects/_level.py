"""The Stribeck level and its lower bound."""

from ehls_ros.arrays import kernel

MIN_LEVEL = 1.0
"""Lower bound of the Stribeck level [N]; the friction models divide by the level."""


@kernel
def shifted_level(level: float, offset: float) -> float:
    """Return a Stribeck level plus an offset, at least :data:`MIN_LEVEL` [N]."""
    return max(level + offset, MIN_LEVEL)
