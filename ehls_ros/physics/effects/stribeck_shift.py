"""The Stribeck curve differs from the identified one in height, velocity range or shape."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._friction import has, shifted_level
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
SHIFTS = ("stribeck_velocity",)
EQUATION = (
    "Fs -> Fs + static_offset, at least Fc;  Vs -> velocity_factor Vs;  δ -> exponent_factor δ, at most 4;  "
    "s(v) -> s(v) + tail_force/(1 + (v/tail_velocity)²), at least 1 N"
)
SOURCE = (
    "Kang et al. 2018, (7); tail: Hess, Soom, Friction at a lubricated line contact operating at oscillating "
    "sliding velocities, Journal of Tribology 112, 1990"
)
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
    tail_force: Annotated[float, quantity("N", "height of a slower fall with speed", minimum=-1e5, maximum=1e5)] = 0.0
    tail_velocity: Annotated[float, quantity("m/s", "speed at which it is half", minimum=1e-5, maximum=10.0)] = 0.01


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add a fall with speed that is slower than an exponential one."""
    return shifted_level(value, p.tail_force / (1.0 + (y[V] / p.tail_velocity) ** 2))


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the curve changed."""
    friction = rig.friction
    return rig.with_friction(
        static_force=max(friction.static_force + parameters.static_offset, friction.coulomb_force),
        stribeck_velocity=parameters.velocity_factor * friction.stribeck_velocity,
        stribeck_exponent=min(parameters.exponent_factor * getattr(friction, "stribeck_exponent", STEEPEST), STEEPEST),
    )


def forms(rig: Rig) -> tuple[Form, ...]:
    """Height, width, or both; or another law, which falls more slowly."""
    if not has(rig, *SHIFTS):
        return ()
    rise = rig.friction.static_force - rig.friction.coulomb_force
    # Close starts: from a width far off, a fit matches the height at wrong speeds, and hardly moves along that curved valley.
    factors = (0.4, 0.65, 1.6, 2.5, 4.0, 6.5)
    return (
        Form({"static_offset": ()}),
        Form({"velocity_factor": factors}),
        Form({"static_offset": (), "velocity_factor": factors}),
        Form(
            {"tail_force": (rise,) * len(factors), "tail_velocity": tuple(f * rig.friction.stribeck_velocity for f in factors)},
            {"static_offset": -rise},
        ),
    )
