"""The load pressure sensors do not read zero at zero pressure; the load cell is not affected."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "sensors"
EQUATION = "pL,read = pL + bias"
SOURCE = "Doebelin, Measurement Systems: Application and Design, 1966: zero shift"
WORDS = Words(
    "the zero of the load pressure sensor",
    lacking=False,
    inspect="inspect the zeros of both pressure sensors and their amplifiers",
    measure="read both pressure sensors with the rig depressurised",
    change="zero the sensors, or give the value as `bias` of `sensors.load_pressure` in the rig file",
)


class Parameters(NamedTuple):
    """The zero shift."""

    bias: Annotated[float, quantity("Pa", "added to the load pressure's reading", minimum=-1e7, maximum=1e7)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the zero shifted."""
    return rig.with_sensors(["load_pressure"], lambda sensor: sensor._replace(bias=sensor.bias + parameters.bias))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The bias."""
    return (Form({"bias": ()}),)
