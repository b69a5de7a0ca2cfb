"""Friction that depends on the direction of motion, as with seals that face one way."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._level import raised
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.friction.base import sign
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "s(v) -> s(v) + offset sgn(v), at least 1 N; at standstill as it was"
SOURCE = "Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, ... machines with friction, Automatica 30, 1994"
WORDS = Words(
    "a Coulomb friction that differs between the directions",
    check="compare slow strokes in both directions; check which way the seals face",
)


class Parameters(NamedTuple):
    """Half the difference of both directions."""

    offset: Annotated[float, quantity("N", "added toward +x, taken off toward -x", minimum=-1e5, maximum=1e5)] = 0.0


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Move the curve up one way and down the other."""
    return raised(value, p.offset * sign(y[V]))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The offset."""
    return (Form({"offset": ()}),)
