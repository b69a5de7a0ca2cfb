"""Contacts that give way more or less before they slip than identified."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "k_i -> factor k_i"
SOURCE = "Kang et al. 2018, (6)"


class Parameters(NamedTuple):
    """Factor on every element's stiffness."""

    factor: Annotated[float, quantity("1", "factor on the presliding stiffness", minimum=0.02, maximum=50.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the stiffness scaled."""
    stiffness = tuple(parameters.factor * value for value in rig.friction.element_stiffness)
    return rig._replace(friction=rig.friction._replace(element_stiffness=stiffness))


def forms(rig: Rig) -> tuple[Form, ...]:
    """Softer, stiffer."""
    return (Form({"factor": (0.5, 1.5, 3.0)}),)
