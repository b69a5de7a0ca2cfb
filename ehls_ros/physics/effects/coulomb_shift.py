"""Friction higher or lower than identified, as another seal, load or oil makes it."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._level import LEAST
from ehls_ros.physics.effects.base import Form, Group
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "s(v) -> s(v) + offset: Fc and Fs move together"
SOURCE = "Olsson, Åström, Canudas de Wit, Gäfvert, Lischinsky, Friction Models and Friction Compensation, 1998"


class Parameters(NamedTuple):
    """How far the Stribeck curve moves."""

    offset: Annotated[float, quantity("N", "what is added to the Stribeck curve", minimum=-1e5, maximum=1e5)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with Coulomb and static friction moved; Fc stays at or above ``LEAST``."""
    coulomb = max(LEAST, rig.friction.coulomb_force + parameters.offset)
    moved = coulomb - rig.friction.coulomb_force
    return rig._replace(friction=rig.friction._replace(coulomb_force=coulomb, static_force=rig.friction.static_force + moved))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The offset."""
    return (Form({"offset": ()}),)
