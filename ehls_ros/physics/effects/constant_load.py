"""A constant force missing in the model: a weight, a hose, a mounting under tension."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "environment"
EQUATION = "F = force"
SOURCE = "Kang et al. 2018, (3), with a constant added on the right side"
WORDS = Words(
    "a constant force",
    inspect="look for weights, hoses and mountings under tension, and for an offset of the load cell",
    measure="read the load cell with the piston free of the load, then at rest at several positions",
    change="keep `constant_load` under `effects` in the rig file, or zero the load cell and record again",
)


class Parameters(NamedTuple):
    """The force."""

    force: Annotated[float, quantity("N", "force along +x", minimum=-1e6, maximum=1e6)] = 0.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the force."""
    return value + p.force


def forms(rig: Rig) -> tuple[Form, ...]:
    """The force."""
    return (Form({"force": ()}),)
