"""The Stribeck level and its floor."""

from ehls_ros.arrays import kernel

LEAST = 1.0
"""A Stribeck curve at zero would leave a slipping element nothing to go to [N]."""


@kernel
def raised(level: float, by: float) -> float:
    """Return a Stribeck level moved, at or above :data:`LEAST` [N]."""
    return max(level + by, LEAST)
