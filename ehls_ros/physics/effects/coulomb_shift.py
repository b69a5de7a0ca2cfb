"""Friction higher or lower than identified, as another seal, load or oil makes it."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import has, shifted
from ehls_ros.physics.effects._level import LEAST
from ehls_ros.physics.effects.base import Form, Stage
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

STAGE: Stage = "friction"
SHIFTS = ("coulomb_force",)
EQUATION = "s(v) -> s(v) + offset: Fc and Fs move together"
SOURCE = "Olsson, Åström, Canudas de Wit, Gäfvert, Lischinsky, Friction Models and Friction Compensation, 1998"


class Parameters(NamedTuple):
    """How far the level of sliding friction moves."""

    offset: Annotated[float, quantity("N", "added to Coulomb and static friction", minimum=-1e5, maximum=1e5)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with Coulomb and static friction moved; Fc stays at or above ``LEAST``."""
    coulomb = max(LEAST, rig.friction.coulomb_force + parameters.offset)
    moved = coulomb - rig.friction.coulomb_force
    static = rig.friction.static_force + moved if has(rig, "static_force") else coulomb
    return shifted(rig, coulomb_force=coulomb, static_force=static)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The offset."""
    return (Form({"offset": ()}),) if has(rig, *SHIFTS) else ()
