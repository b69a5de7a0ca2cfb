"""Viscous friction higher or lower than identified."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "σf -> σf + added, at least 0"
SOURCE = "Kang et al. 2018, (5)"


class Parameters(NamedTuple):
    """What is added to the viscous coefficient."""

    added: Annotated[float, quantity("N s/m", "added to the viscous coefficient", minimum=-1e6, maximum=1e6)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with viscous friction moved."""
    viscous = max(rig.friction.viscous_coefficient + parameters.added, 0.0)
    return rig._replace(friction=rig.friction._replace(viscous_coefficient=viscous))


def forms(rig: Rig) -> tuple[Form, ...]:
    """What is added."""
    return (Form({"added": ()}),)
