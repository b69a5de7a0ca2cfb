"""The Stribeck curve differs from the identified one in height, velocity range or shape."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import has
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
SHIFTS = ("stribeck_velocity",)
EQUATION = "Fs -> Fs + static_offset, at least Fc;  Vs -> velocity_factor Vs;  δ -> exponent_factor δ, at most 4"
SOURCE = "Kang et al. 2018, (7); Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30, 1994"
WORDS = Words(
    "the Stribeck curve",
    lacking=False,
    inspect="inspect lubrication and state of the seals",
    measure="record slow strokes at some ten speeds around the Stribeck velocity",
    change="identify `static_force`, `stribeck_velocity` and `stribeck_exponent` again by `ehls identify`",
)

STEEPEST = 4.0
"""Largest exponent of a Stribeck curve."""


class Parameters(NamedTuple):
    """Changes of height, width and shape of the Stribeck curve."""

    static_offset: Annotated[float, quantity("N", "added to the static friction", minimum=-1e5, maximum=1e5)] = 0.0
    velocity_factor: Annotated[float, quantity("1", "factor on the Stribeck velocity", minimum=0.02, maximum=50.0)] = 1.0
    exponent_factor: Annotated[float, quantity("1", "factor on the curve's exponent", minimum=0.1, maximum=10.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the curve changed."""
    friction = rig.friction
    return rig.with_friction(
        static_force=max(friction.static_force + parameters.static_offset, friction.coulomb_force),
        stribeck_velocity=parameters.velocity_factor * friction.stribeck_velocity,
        stribeck_exponent=min(parameters.exponent_factor * getattr(friction, "stribeck_exponent", STEEPEST), STEEPEST),
    )


def forms(rig: Rig) -> tuple[Form, ...]:
    """Height, width, or both."""
    if not has(rig, *SHIFTS):
        return ()
    # Close starts: from a width far off, a fit matches the height at wrong speeds, and hardly moves along that curved valley.
    factors = (0.4, 0.65, 1.6, 2.5, 4.0, 6.5)
    return (
        Form({"static_offset": ()}),
        Form({"velocity_factor": factors}),
        Form({"static_offset": (), "velocity_factor": factors}),
    )
