"""Presence of friction coefficients, and the Stribeck level with its lower bound."""

from ehls_ros.arrays import kernel
from ehls_ros.physics.rig import Rig

MIN_LEVEL = 1.0
"""Lower bound of the Stribeck level [N]; the friction models divide by the level."""

STIFFNESSES = ("element_stiffness", "presliding_stiffness")
"""Coefficients of the presliding stiffness, by friction model."""


@kernel
def shifted_level(level: float, offset: float) -> float:
    """Return a Stribeck level plus an offset, at least :data:`MIN_LEVEL` [N]."""
    return max(level + offset, MIN_LEVEL)


def stiffened(rig: Rig, factor: float) -> Rig:
    """Return a rig with the presliding stiffness of its friction scaled."""
    friction = rig.friction
    return rig.with_friction(
        element_stiffness=tuple(factor * value for value in getattr(friction, "element_stiffness", ())),
        presliding_stiffness=factor * getattr(friction, "presliding_stiffness", 0.0),
    )


def has(rig: Rig, *keys: str) -> bool:
    """Return whether a rig's friction model has at least one of the coefficients."""
    return bool(set(keys) & set(rig.friction._fields))
