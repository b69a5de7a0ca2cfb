"""Another fall of friction between standstill and motion than identified."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import has, shifted
from ehls_ros.physics.effects.base import Form, Stage
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

STAGE: Stage = "friction"
SHIFTS = ("stribeck_velocity",)
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
    return shifted(
        rig,
        static_force=max(friction.static_force + parameters.static_offset, friction.coulomb_force),
        stribeck_velocity=parameters.velocity_factor * friction.stribeck_velocity,
        stribeck_exponent=min(parameters.exponent_factor * getattr(friction, "stribeck_exponent", STEEPEST), STEEPEST),
    )


def forms(rig: Rig) -> tuple[Form, ...]:
    """The height, the width, both."""
    if not has(rig, *SHIFTS):
        return ()
    # Where the fall is much wider, a fit would first match its height at the wrong speeds: so it starts on either side.
    factors = (0.4, 2.0, 5.0)
    return (
        Form({"static_offset": ()}),
        Form({"velocity_factor": factors}),
        Form({"static_offset": (), "velocity_factor": factors}),
    )
