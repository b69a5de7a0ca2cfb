"""Friction that varies along the stroke: an out-of-round tube, a bent rod, a worn guide."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._friction import shifted_level
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import X
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "s -> s + slope x + curvature x² + cubic x³ + sine sin(2π x/wavelength) + cosine cos(2π x/wavelength), at least 1 N"
SOURCE = "Armstrong-Hélouvry, Control of Machines with Friction, 1991: position-dependent friction"
WORDS = Words(
    "a friction that changes along the stroke",
    inspect="inspect tube, rod and guides where friction is highest",
    measure="record one slow stroke from end to end in both directions",
    change="keep `position_dependent_friction` under `effects` in the rig file",
)


class Parameters(NamedTuple):
    """Change of the Stribeck level with position; where the change is zero, the rig file's friction applies."""

    slope: Annotated[float, quantity("N/m", "Stribeck level per position", minimum=-1e6, maximum=1e6)] = 0.0
    curvature: Annotated[float, quantity("N/m^2", "Stribeck level per squared position", minimum=-1e8, maximum=1e8)] = 0.0
    cubic: Annotated[float, quantity("N/m^3", "Stribeck level per cubed position", minimum=-1e10, maximum=1e10)] = 0.0
    sine: Annotated[float, quantity("N", "sine part of a wave along the stroke", minimum=-1e5, maximum=1e5)] = 0.0
    cosine: Annotated[float, quantity("N", "cosine part of a wave along the stroke", minimum=-1e5, maximum=1e5)] = 0.0
    wavelength: Annotated[float, quantity("m", "length of the wave", minimum=1e-3, maximum=10.0)] = 0.1


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the level with the position."""
    angle = 2.0 * math.pi * y[X] / p.wavelength
    polynomial = (p.slope + (p.curvature + p.cubic * y[X]) * y[X]) * y[X]
    return shifted_level(value, polynomial + p.sine * math.sin(angle) + p.cosine * math.cos(angle))


def forms(rig: Rig) -> tuple[Form, ...]:
    """A slope, a parabola, a cubic, or a wave, with starting wavelengths from shorter to longer than the stroke."""
    wavelengths = tuple(Share("position_m", fraction) for fraction in (0.3, 0.7, 1.5))
    return (
        Form({"slope": ()}),
        Form({"slope": (), "curvature": ()}),
        Form({"slope": (), "curvature": (), "cubic": ()}),
        Form({"sine": (), "cosine": (), "wavelength": wavelengths}),
    )
