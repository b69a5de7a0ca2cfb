"""Viscous friction higher or lower than identified."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import has, shifted
from ehls_ros.physics.effects.base import Form, Stage
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

STAGE: Stage = "friction"
SHIFTS = ("viscous_coefficient",)
EQUATION = "σf -> σf + added, at least 0"
SOURCE = "Kang et al. 2018, (5)"


class Parameters(NamedTuple):
    """How far the viscous coefficient moves."""

    added: Annotated[float, quantity("N s/m", "added to the viscous coefficient", minimum=-1e6, maximum=1e6)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with viscous friction moved."""
    return shifted(rig, viscous_coefficient=max(rig.friction.viscous_coefficient + parameters.added, 0.0))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The added coefficient."""
    return (Form({"added": ()}),) if has(rig, *SHIFTS) else ()
