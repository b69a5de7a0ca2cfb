"""The oil column is stiffer or softer than in the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "βe -> factor βe"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 2: effective bulk modulus with gas and elastic walls"
WORDS = Words(
    "the bulk modulus of the oil",
    lacking=False,
    inspect="inspect the hoses between valve and cylinder, the chambers' volumes and the oil for air",
    measure="close the valve, push the piston by a known force and compare its travel with the column's stiffness",
    change="multiply `bulk_modulus` in the rig file by the factor, unless bleeding restores it",
)


class Parameters(NamedTuple):
    """Factor on the bulk modulus."""

    factor: Annotated[float, quantity("1", "factor on the effective bulk modulus", minimum=0.01, maximum=10.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the bulk modulus scaled."""
    return rig.with_plant(bulk_modulus=parameters.factor * rig.plant.bulk_modulus)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The factor, also from a soft and a stiff oil: the compressibility is its inverse, and far away from 1."""
    return (Form({"factor": (0.4, 0.9, 2.5)}),)
