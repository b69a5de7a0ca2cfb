"""Coulomb friction that depends on the direction of motion, as with single-acting seals."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._friction import shifted_level
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.friction.base import sign
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "s(v) -> s(v) + offset sgn(v), at least 1 N; unchanged at standstill"
SOURCE = "Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, ... machines with friction, Automatica 30, 1994"
WORDS = Words(
    "a Coulomb friction that differs between the directions",
    inspect="inspect which way the seals face, and the wiper of the rod",
    measure="record slow strokes at one speed in both directions and compare their forces",
    change="keep `coulomb_asymmetry` under `effects` in the rig file",
)


class Parameters(NamedTuple):
    """Half the difference between the directions."""

    offset: Annotated[float, quantity("N", "added in motion along +x, subtracted along -x", minimum=-1e5, maximum=1e5)] = 0.0


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Raise the level in one direction and lower it in the other."""
    return shifted_level(value, p.offset * sign(y[V]))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The offset."""
    return (Form({"offset": ()}),)
