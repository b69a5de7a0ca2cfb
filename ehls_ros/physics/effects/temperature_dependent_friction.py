"""Friction that changes with the oil temperature: warmer oil is thinner and lubricates the seals less."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._friction import shifted_level
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import TEMPERATURE, V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "s(v) -> s(v) + a (T - T0), at least 1 N;  Ff -> Ff + (b (T - T0) + σ (exp(-c (T - T0)) - 1)) v"
SOURCE = "Simoni, Beschi, Legnani, Visioli, Modelling the temperature in joint friction of industrial manipulators, 2019"
WORDS = Words(
    "a friction that changes with the oil's temperature",
    inspect="inspect the oil's grade and the cooler",
    measure="repeat a slow stroke cold and warm, and record the oil's temperature",
    change="keep `temperature_dependent_friction` under `effects` in the rig file, or warm up before each run",
)
NEEDS = ("oil_temperature_k",)


class Parameters(NamedTuple):
    """Temperature coefficients; at the reference temperature the rig file's friction applies."""

    coulomb_slope: Annotated[
        float, quantity("N/K", "change of Coulomb and static friction per kelvin", minimum=-1e3, maximum=1e3)
    ] = 0.0
    viscous_slope: Annotated[
        float, quantity("N s/(m K)", "change of viscous friction per kelvin", minimum=-1e4, maximum=1e4)
    ] = 0.0
    thinning_part: Annotated[
        float, quantity("N s/m", "viscous friction proportional to the oil's viscosity", minimum=0.0, maximum=1e6)
    ] = 0.0
    thinning_rate: Annotated[
        float, quantity("1/K", "decay rate of the viscosity over temperature", minimum=-0.2, maximum=0.2)
    ] = 0.0
    reference_temperature: Annotated[
        float, quantity("K", "temperature at which the rig file's friction applies", minimum=200.0, maximum=450.0)
    ] = 313.15


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the level with the temperature."""
    return shifted_level(value, p.coulomb_slope * (w[TEMPERATURE] - p.reference_temperature))


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Subtract the change of viscous friction."""
    difference = w[TEMPERATURE] - p.reference_temperature
    return value - (p.viscous_slope * difference + p.thinning_part * (math.exp(-p.thinning_rate * difference) - 1.0)) * y[V]


def forms(rig: Rig) -> tuple[Form, ...]:
    """One slope, both, or an exponential viscosity."""
    return (
        Form({"coulomb_slope": ()}),
        Form({"viscous_slope": ()}),
        Form({"coulomb_slope": (), "viscous_slope": ()}),
        Form({"thinning_rate": ()}, {"thinning_part": rig.friction.viscous_coefficient}),
    )
