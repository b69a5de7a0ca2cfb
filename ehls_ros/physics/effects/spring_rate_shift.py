"""The spring device is stiffer or softer than in the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "mechanics"
EQUATION = "ks -> ks + added, at least 0"
SOURCE = "Kang et al. 2018, (3)"
WORDS = Words(
    "the stiffness of the spring",
    lacking=False,
    inspect="inspect which spring is mounted, and its fixtures",
    measure="measure the spring's force at rest at two positions",
    change="add the fitted value to `spring_stiffness` in the rig file",
)


class Parameters(NamedTuple):
    """Change of the stiffness."""

    added: Annotated[float, quantity("N/m", "added to the spring's stiffness", minimum=-1e8, maximum=1e8)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the stiffness shifted."""
    stiffness = max(rig.plant.spring_stiffness + parameters.added, 0.0)
    return rig.with_plant(spring_stiffness=stiffness)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The added stiffness."""
    return (Form({"added": ()}),)
