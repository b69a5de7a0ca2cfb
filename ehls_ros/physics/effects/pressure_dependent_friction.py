"""Friction that grows with the load pressure, as the oil presses the seals against their faces."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._friction import shifted_level
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = (
    "s(v) -> s(v) (1 + growth |pL|) + slope h + chamber_slope pL, at least 1 N;  Ff -> Ff + viscous_part growth |pL| v;  "
    "h = √(pL² + onset²) - onset, |pL| far beyond the onset, with a saturation h -> saturation (1 - exp(-h/saturation)), "
    "with an exponent h -> (h/1 MPa)^exponent 1 MPa"
)
SOURCE = (
    "Bonchis, Corke, Rye, A pressure-based, velocity independent, friction model for asymmetric hydraulic cylinders, ICRA 1999"
)
WORDS = Words(
    "a friction that grows with the pressure",
    inspect="inspect type and fit of the seals",
    measure="repeat a slow stroke at several loads and compare the friction",
    change="keep `pressure_dependent_friction` under `effects` in the rig file",
)


UNIT_PRESSURE = 1e6
"""Pressure at which the level grows by the same for any exponent [Pa]."""


class Parameters(NamedTuple):
    """Friction per pressure; at zero load pressure the rig file's friction applies."""

    slope: Annotated[float, quantity("N/Pa", "Stribeck level per load pressure", minimum=-0.05, maximum=0.05)] = 0.0
    onset: Annotated[float, quantity("Pa", "load pressure above which friction grows linearly", minimum=0.0, maximum=1e7)] = 0.0
    saturation: Annotated[
        float, quantity("Pa", "load pressure over which the seals settle on their faces; 0: any", minimum=0.0, maximum=1e8)
    ] = 0.0
    exponent: Annotated[float, quantity("1", "exponent of the growth over 1 MPa", minimum=0.2, maximum=3.0)] = 1.0
    chamber_slope: Annotated[
        float,
        quantity("N/Pa", "Stribeck level per load pressure, signed: a seal of one chamber", minimum=-0.05, maximum=0.05),
    ] = 0.0
    growth: Annotated[
        float, quantity("1/Pa", "relative growth of level and viscous part per load pressure", minimum=-1e-6, maximum=1e-5)
    ] = 0.0
    viscous_part: Annotated[float, quantity("N s/m", "viscous friction that grows so", minimum=0.0, maximum=1e6)] = 0.0


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the level with the pressure."""
    pressure = math.hypot(y[PL], p.onset) - p.onset
    if p.saturation > 0.0:
        pressure = -p.saturation * math.expm1(-pressure / p.saturation)
    if p.exponent != 1.0:
        pressure = UNIT_PRESSURE * (pressure / UNIT_PRESSURE) ** p.exponent
    return shifted_level(value, p.slope * pressure + p.chamber_slope * y[PL] + p.growth * abs(y[PL]) * value)


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Subtract the change of viscous friction."""
    return value - p.viscous_part * p.growth * abs(y[PL]) * y[V]


def forms(rig: Rig) -> tuple[Form, ...]:
    """The level in proportion, with an onset, a saturation or an exponent, by one chamber's pressure; or the whole curve."""
    return (
        Form({"slope": ()}),
        Form({"slope": (), "onset": (5e4, 2e5, 5e5)}),
        Form({"slope": (), "saturation": (5e5, 2e6)}),
        Form({"slope": (), "exponent": (0.6, 1.5)}),
        Form({"chamber_slope": ()}),
        Form({"growth": ()}, {"viscous_part": rig.friction.viscous_coefficient}),
    )
