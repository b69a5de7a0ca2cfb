"""Coulomb and static friction are higher or lower than identified, as with another seal, load or oil."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import MIN_LEVEL, has
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
SHIFTS = ("coulomb_force",)
EQUATION = "s(v) -> s(v) + offset: Fc and Fs move together"
SOURCE = "Olsson, Åström, Canudas de Wit, Gäfvert, Lischinsky, Friction Models and Friction Compensation, 1998"
WORDS = Words(
    "the Coulomb friction",
    lacking=False,
    inspect="inspect seals, alignment and side load",
    measure="record a slow stroke to and fro: half the difference of the forces is the Coulomb friction",
    change="add the offset to `coulomb_force` and `static_force` in the rig file, or identify both again by `ehls identify`",
)


class Parameters(NamedTuple):
    """Change of the Stribeck level."""

    offset: Annotated[float, quantity("N", "added to Coulomb and static friction", minimum=-1e5, maximum=1e5)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with Coulomb and static friction shifted; Fc stays at least :data:`MIN_LEVEL`."""
    coulomb = max(MIN_LEVEL, rig.friction.coulomb_force + parameters.offset)
    moved = coulomb - rig.friction.coulomb_force
    static = rig.friction.static_force + moved if has(rig, "static_force") else coulomb
    return rig.with_friction(coulomb_force=coulomb, static_force=static)


def forms(rig: Rig) -> tuple[Form, ...]:
    """Offset from a zero start and from several: it determines when a stuck piston breaks away, so small offsets mislead."""
    if not has(rig, *SHIFTS):
        return ()
    return Form({"offset": ()}), Form({"offset": tuple(part * rig.friction.coulomb_force for part in (-0.2, -0.1, 0.1, 0.2))})
