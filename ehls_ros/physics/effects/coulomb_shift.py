"""Coulomb and static friction are higher or lower than identified, as with another seal, load or oil."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import MIN_LEVEL, STIFFNESSES, has, stiffened
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
SHIFTS = ("coulomb_force",)
FIXED = ("stiffening",)
EQUATION = "s(v) -> s(v) + offset: Fc and Fs move together, and k_i or σ0 by the share stiffening of the relative change of Fc"
SOURCE = (
    "Olsson, Åström, Canudas de Wit, Gäfvert, Lischinsky, Friction Models and Friction Compensation, 1998; stiffness in "
    "proportion to the load of a contact: Johnson, Contact Mechanics, 1985, ch. 7"
)
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
    stiffening: Annotated[
        float, quantity("1", "share of the relative change that the presliding stiffness follows", minimum=0.0, maximum=1.0)
    ] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with Coulomb and static friction shifted; Fc stays at least :data:`MIN_LEVEL`."""
    before = rig.friction.coulomb_force
    coulomb = max(MIN_LEVEL, before + parameters.offset)
    moved = coulomb - before
    static = rig.friction.static_force + moved if has(rig, "static_force") else coulomb
    return stiffened(rig, 1.0 + parameters.stiffening * moved / before).with_friction(
        coulomb_force=coulomb, static_force=static
    )


def forms(rig: Rig) -> tuple[Form, ...]:
    """Offset from a zero start and from several: it determines when a stuck piston breaks away, so small offsets mislead.

    With the stiffness of presliding as it was, and with its displacement as it was, as where a seal presses harder.
    """
    if not has(rig, *SHIFTS):
        return ()
    several = {"offset": tuple(part * rig.friction.coulomb_force for part in (-0.2, -0.1, 0.1, 0.2))}
    pressed = (Form(several, {"stiffening": 1.0}),) if has(rig, *STIFFNESSES) else ()
    return Form({"offset": ()}), Form(several), *pressed
