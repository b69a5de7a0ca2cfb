"""Every hook at once, each with a separate parameter; and the position, recomputed by integration."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, V
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP = "mechanics"
EQUATION = "see the hooks"
SOURCE = "a test"
WORDS = Words("a probe", inspect="look at every hook", measure="measure them", change="remove it")
STATES = 1
REACH = 0.0


class Parameters(NamedTuple):
    """One parameter per hook."""

    received: Annotated[float, quantity("1", "fraction that arrives", minimum=0.0, maximum=2.0)] = 1.0
    command: Annotated[float, quantity("1", "gain of the command", minimum=0.0, maximum=2.0)] = 1.0
    opening: Annotated[float, quantity("1", "gain of the opening", minimum=0.0, maximum=2.0)] = 1.0
    supply_pressure: Annotated[float, quantity("1", "fraction of the supply pressure", minimum=0.0, maximum=2.0)] = 1.0
    bulk_modulus: Annotated[float, quantity("1", "fraction of the bulk modulus", minimum=0.0, maximum=2.0)] = 1.0
    leakage: Annotated[float, quantity("m^5/(N s)", "additional leakage", minimum=0.0, maximum=1e-10)] = 0.0
    friction_level: Annotated[float, quantity("1", "fraction of the friction", minimum=0.0, maximum=2.0)] = 1.0
    force: Annotated[float, quantity("N/m", "a spring", minimum=0.0, maximum=1e6)] = 0.0
    piston_position: Annotated[
        float, quantity("1", "travel of the piston per travel of the mass", minimum=0.0, maximum=2.0)
    ] = 1.0
    piston_velocity: Annotated[
        float, quantity("1", "velocity of the piston per velocity of the mass", minimum=0.0, maximum=2.0)
    ] = 1.0
    position_reading: Annotated[float, quantity("m", "error of the position", minimum=0.0, maximum=1.0)] = 0.0
    pressure_reading: Annotated[float, quantity("Pa", "error of the load pressure", minimum=0.0, maximum=1e8)] = 0.0
    force_reading: Annotated[float, quantity("N", "error of the force", minimum=0.0, maximum=1e6)] = 0.0


@kernel
def received(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.received


def reach(p: Parameters) -> float:
    return REACH


@kernel
def jump(t: float, w: Array, p: Parameters) -> float:
    return t + 0.31e-3


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.command


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.opening


@kernel
def supply_pressure(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.supply_pressure


@kernel
def bulk_modulus(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.bulk_modulus


@kernel
def leakage(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value + p.leakage * y[PL]


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.friction_level


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value - p.force * z[0]


@kernel
def piston_position(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.piston_position


@kernel
def piston_velocity(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value * p.piston_velocity


@kernel
def position_reading(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value + p.position_reading


@kernel
def pressure_reading(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value + p.pressure_reading


@kernel
def force_reading(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    return value + p.force_reading


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    dz[0] = y[V]


def forms(rig: Rig) -> tuple[Form, ...]:
    return (Form({"force": ()}),)
