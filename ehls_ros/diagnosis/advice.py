"""Advice for a named cause: that of its effect's file, unless the recording itself explains the cause."""

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.result import Cause
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Words
from ehls_ros.physics.rig import Rig

SPRING, ADDED = "spring_rate_shift", "added"
"""The effect that changes the spring's stiffness, and its parameter."""


def advice(rig: Rig, cause: Cause) -> Words:
    """Return the terms and the advice for a cause.

    Args:
        rig: the given model.
        cause: the cause.
    """
    words: Words = EFFECTS.load(cause.name).WORDS
    if not spring_in_force(rig, cause):
        return words
    return words._replace(
        inspect="check where the load cell sits: behind the spring, its reading contains the spring's force already",
        measure="hold the piston at two positions without load and compare the readings",
        change="map the cell as `load_cell_n`, with the mass before it as `moving_mass`, or set `spring_stiffness` to 0",
    )


def spring_in_force(rig: Rig, cause: Cause) -> bool:
    """Return whether a cause removes the spring of the rig file: the recorded force contains it already, or none is mounted."""
    stiffness, added = rig.plant.spring_stiffness, cause.parameters.get(ADDED)
    if cause.name != SPRING or added is None or not stiffness > 0.0:
        return False
    # A fit beyond zero stiffness has no effect.
    return added.value + stiffness <= max(rules.SPRING_LEFT * stiffness, rules.SPRING_SIGMAS * added.std)
