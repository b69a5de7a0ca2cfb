"""Delayed readings: a slow converter or bus, or channels that are not sampled simultaneously."""

from collections.abc import Callable
from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import CHAMBER_SENSED, SENSED, Rig
from ehls_ros.schema import quantity

GROUP: Group = "sensors"
EQUATION = "read(t) = true(t - delay)"
SOURCE = "Doebelin, Measurement Systems: Application and Design, 1966: dead-time elements"
WORDS = Words(
    "a delay of a sensor",
    inspect="inspect how the channels are sampled: converter, multiplexer, bus, filters",
    measure="feed one signal to all channels and compare their samples",
    change="sample all channels together, or give the value as `delay` of the sensor in the rig file",
)


class Parameters(NamedTuple):
    """Delays of position and load pressure, and one common to all channels."""

    position: Annotated[float, quantity("s", "delay of the position's reading", minimum=0.0, maximum=0.5)] = 0.0
    pressure: Annotated[float, quantity("s", "delay of the load pressure's reading", minimum=0.0, maximum=0.5)] = 0.0
    every: Annotated[float, quantity("s", "delay of every reading", minimum=0.0, maximum=0.5)] = 0.0


def later(by: float) -> Callable[[Sensor], Sensor]:
    """Return the function that delays a sensor by a time [s]."""
    return lambda sensor: sensor._replace(delay=sensor.delay + by)


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the delays added."""
    rig = rig.with_sensors(SENSED, later(parameters.every))
    rig = rig.with_sensors(["position"], later(parameters.position))
    return rig.with_sensors(["load_pressure"], later(parameters.pressure))


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the delays added to the sensors of its chambers."""
    return rig.with_sensors(CHAMBER_SENSED, later(parameters.every + parameters.pressure))


def forms(rig: Rig) -> tuple[Form, ...]:
    """One of the delays, with short, medium and long starting values."""
    return tuple(Form({name: (0.001, 0.004, 0.012)}) for name in Parameters._fields)
