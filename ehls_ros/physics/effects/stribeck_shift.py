"""Another fall of friction between standstill and motion than identified."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "Fs -> Fs + static_offset, at least Fc;  Vs -> velocity_factor Vs;  δ -> exponent_factor δ, at most 4"
SOURCE = "Kang et al. 2018, (7); Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30, 1994"

STEEPEST = 4.0
"""Largest exponent of a Stribeck curve."""


class Parameters(NamedTuple):
    """How height, width and shape of the fall change."""

    static_offset: Annotated[float, quantity("N", "added to the static friction", minimum=-1e5, maximum=1e5)] = 0.0
    velocity_factor: Annotated[float, quantity("1", "factor on the Stribeck velocity", minimum=0.02, maximum=50.0)] = 1.0
    exponent_factor: Annotated[float, quantity("1", "factor on the curve's exponent", minimum=0.1, maximum=10.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the curve changed."""
    friction = rig.friction
    return rig._replace(
        friction=friction._replace(
            static_force=max(friction.static_force + parameters.static_offset, friction.coulomb_force),
            stribeck_velocity=parameters.velocity_factor * friction.stribeck_velocity,
            stribeck_exponent=min(parameters.exponent_factor * friction.stribeck_exponent, STEEPEST),
        )
    )


def forms(rig: Rig) -> tuple[Form, ...]:
    """The height, the width, both."""
    # A fall that is wider by far has its height fitted to the wrong speeds first: starts on either side of it.
    factors = (0.4, 2.0, 5.0)
    return (
        Form({"static_offset": ()}),
        Form({"velocity_factor": factors}),
        Form({"static_offset": (), "velocity_factor": factors}),
    )
