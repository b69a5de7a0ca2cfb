"""The moving mass, and with it the weight, is larger or smaller than in the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = "m0 -> factor m0"
SOURCE = "Kang et al. 2018, (3)"
WORDS = Words(
    "the moving mass",
    lacking=False,
    inspect="inspect what moves with the piston: fixtures, oil, couplings",
    measure="weigh the moving parts, or add a known mass and record again",
    change="multiply `moving_mass` in the rig file by the factor",
)


class Parameters(NamedTuple):
    """Factor on the moving mass."""

    factor: Annotated[float, quantity("1", "factor on the moving mass", minimum=0.02, maximum=50.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the mass scaled."""
    return rig.with_plant(moving_mass=parameters.factor * rig.plant.moving_mass)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The factor."""
    return (Form({"factor": ()}),)
