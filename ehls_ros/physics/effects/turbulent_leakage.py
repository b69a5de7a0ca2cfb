"""Turbulent leakage through a worn edge or a scratch, which acts as an orifice rather than a capillary."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "leakage -> leakage + coefficient pL / (pL² + transition²)^(1/4), coefficient sgn(pL) √|pL| beyond the transition"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 3: turbulent flow through an orifice"
WORDS = Words(
    "a leakage through an orifice",
    inspect="look for a worn edge, a scratch or an open relief valve",
    measure="measure the leakage at three pressures: it grows with their square root",
    change="keep `turbulent_leakage` under `effects` in the rig file until the part is replaced",
)


class Parameters(NamedTuple):
    """Size of the orifice."""

    coefficient: Annotated[
        float, quantity("m^3/(s Pa^0.5)", "leakage per square root of the load pressure", minimum=0.0, maximum=1e-6)
    ] = 0.0
    transition: Annotated[float, quantity("Pa", "load pressure below which the flow is laminar", minimum=0.0, maximum=1e7)] = (
        0.0
    )


@kernel
def orifice_flow(pressure: float, p: Parameters) -> float:
    """Return the flow at a pressure difference [m^3/s]."""
    scale = math.sqrt(math.hypot(pressure, p.transition))
    return p.coefficient * pressure / scale if scale > 0.0 else 0.0


@kernel
def leakage(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the orifice flow."""
    return value + orifice_flow(y[PL], p)


@kernel
def piston_leakage(
    value: float, difference: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant
) -> float:
    """Add the orifice flow from chamber A to B."""
    return value + orifice_flow(difference, p)


def forms(rig: Rig) -> tuple[Form, ...]:
    """Turbulent at all pressures, or laminar at low ones."""
    return Form({"coefficient": ()}), Form({"coefficient": (), "transition": (5e4, 2e5, 5e5)})
