"""Viscous friction other than identified."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import has
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
SHIFTS = ("viscous_coefficient",)
EQUATION = "σf -> σf + added, at least 0"
SOURCE = "Kang et al. 2018, (5)"
WORDS = Words(
    "the viscous friction",
    lacking=False,
    inspect="inspect the oil's grade, viscosity and temperature",
    measure="record strokes at three speeds and read the slope of friction over speed",
    change="add the fitted value to `viscous_coefficient` in the rig file, or identify it again by `ehls identify`",
)


class Parameters(NamedTuple):
    """Change of the viscous coefficient."""

    added: Annotated[float, quantity("N s/m", "added to the viscous coefficient", minimum=-1e6, maximum=1e6)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the viscous coefficient shifted."""
    return rig.with_friction(viscous_coefficient=max(rig.friction.viscous_coefficient + parameters.added, 0.0))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The added coefficient."""
    return (Form({"added": ()}),) if has(rig, *SHIFTS) else ()
