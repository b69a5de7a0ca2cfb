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
EQUATION = (
    "s(v) -> s(v) + offset + forward along +x, s(v) - offset + backward along -x, at least 1 N; the mean of both at standstill"
)
SOURCE = "Armstrong-Hélouvry, Dupont, Canudas de Wit, A survey of models, ... machines with friction, Automatica 30, 1994"
WORDS = Words(
    "a Coulomb friction that differs between the directions",
    inspect="inspect which way the seals face, and the wiper of the rod",
    measure="record slow strokes at one speed in both directions and compare their forces",
    change="keep `coulomb_asymmetry` under `effects` in the rig file",
)


class Parameters(NamedTuple):
    """Half the difference between the directions, or a change in one of them."""

    offset: Annotated[float, quantity("N", "added in motion along +x, subtracted along -x", minimum=-1e5, maximum=1e5)] = 0.0
    forward: Annotated[float, quantity("N", "added in motion along +x only", minimum=-1e5, maximum=1e5)] = 0.0
    backward: Annotated[float, quantity("N", "added in motion along -x only", minimum=-1e5, maximum=1e5)] = 0.0


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Raise the level in one direction and lower it in the other, or change it in one of them."""
    direction = sign(y[V])
    difference = p.offset + 0.5 * (p.forward - p.backward)
    return shifted_level(value, 0.5 * (p.forward + p.backward) + difference * direction)


def forms(rig: Rig) -> tuple[Form, ...]:
    """Opposite changes in both directions, or a change in one of them."""
    return Form({"offset": ()}), Form({"forward": ()}), Form({"backward": ()})
