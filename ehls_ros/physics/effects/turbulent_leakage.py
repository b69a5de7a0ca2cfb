"""Leakage through a worn edge or a scratch, an orifice rather than a capillary."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Stage
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

STAGE: Stage = "flow"
EQUATION = "leakage -> leakage + coefficient sgn(pL) √|pL|"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 3: turbulent flow through an orifice"


class Parameters(NamedTuple):
    """Size of the orifice."""

    coefficient: Annotated[
        float, quantity("m^3/(s Pa^0.5)", "leakage per square root of the load pressure", minimum=0.0, maximum=1e-6)
    ] = 0.0


@kernel
def leakage(value: float, t: float, y: Array, w: Array, z: Array, p: Array, plant: Plant) -> float:
    """Add what passes."""
    return value + p[0] * math.copysign(math.sqrt(abs(y[PL])), y[PL])


def forms(rig: Rig) -> tuple[Form, ...]:
    """The coefficient."""
    return (Form({"coefficient": ()}),)
