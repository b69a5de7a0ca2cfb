"""The supply pressure drops under flow: pressure is lost between pump and valve.

The flow is that of (1) at the spool displacement, without other effects on the opening.
"""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.duals import value_of
from ehls_ros.physics.effects._play import FOLLOW_RATE
from ehls_ros.physics.effects.base import MEMORY_STEP, Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, XV
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "ps -> ps - loss, at least 0;  loss = resistance |QL| + quadratic QL², instantaneous or with a first-order lag"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 3: pressure lost in laminar and turbulent flow; ch. 11: supplies"
WORDS = Words(
    "a supply pressure that droops under flow",
    inspect="inspect pump control, accumulator charge, line and filter",
    measure="record the supply pressure at the valve during a fast stroke",
    change="keep `supply_pressure_droop` under `effects` in the rig file, or record the supply pressure",
)
STATES = 1
LAG_STEP = 0.1
"""Longest integration step, as a fraction of the lag; a step of fourth order errs by 1e-7 of what decays."""
NOT_IN_CHAMBERS = ("quadratic", "time_constant")


class Parameters(NamedTuple):
    """Pressure loss of line and supply, and its lag."""

    resistance: Annotated[float, quantity("Pa s/m^3", "pressure lost per flow", minimum=0.0, maximum=1e12)] = 0.0
    quadratic: Annotated[float, quantity("Pa s^2/m^6", "pressure lost per squared flow", minimum=0.0, maximum=1e16)] = 0.0
    time_constant: Annotated[float, quantity("s", "lag of the loss; 0: instantaneous", minimum=0.0, maximum=10.0)] = 0.0


@kernel
def conductance(y: Array, plant: Plant) -> float:
    """Return QL² per pressure across the valve [m^6/(s^2 Pa)]."""
    area = plant.discharge_coefficient * plant.valve_area_gradient * y[XV]
    return area * area / plant.oil_density


@kernel
def drop(supply: float, y: Array) -> float:
    """Return the pressure drop across the valve, at least 0 [Pa]."""
    return max(supply - math.copysign(y[PL], y[PL] * y[XV]), 0.0)


@kernel
def supply_pressure(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Subtract the loss; an instantaneous one follows from QL² = conductance (drop - loss(QL)), quadratic in QL."""
    if p.time_constant > 0.0:
        loss = z[0]
    else:
        squared = conductance(y, plant)
        a, b = 1.0 + squared * p.quadratic, squared * p.resistance
        flow = (math.sqrt(b * b + 4.0 * a * squared * drop(value, y)) - b) / (2.0 * a)
        loss = (p.resistance + p.quadratic * flow) * flow
    return max(value - loss, 0.0)


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    """Write the rate of the loss towards its steady value at the present flow."""
    squared = conductance(y, plant) * drop(plant.supply_pressure - z[0], y)
    dz[0] = (p.resistance * math.sqrt(squared) + p.quadratic * squared - z[0]) / max(p.time_constant, 1.0 / FOLLOW_RATE)


def longest_step(parameters: Parameters) -> float:
    """Return the longest integration step of the lagging loss; an instantaneous one needs none [s]."""
    lag = parameters.time_constant
    return max(MEMORY_STEP, LAG_STEP * float(value_of(lag))) if lag > 0.0 else math.inf


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the resistance added to that of its supply, which has a lag of its own."""
    return rig.with_cylinder(supply_resistance=rig.cylinder.parameters.supply_resistance + parameters.resistance)


def forms(rig: Rig) -> tuple[Form, ...]:
    """A laminar or a turbulent loss, each without or with a lag; in a supply with a lag of its own, its resistance."""
    if rig.cylinder.law.CHAMBERS:
        return (Form({"resistance": ()}),)
    lag = {"time_constant": (0.05,)}
    return (
        Form({"resistance": ()}),
        Form({"quadratic": ()}),
        Form({"resistance": (), **lag}),
        Form({"quadratic": (), **lag}),
    )
