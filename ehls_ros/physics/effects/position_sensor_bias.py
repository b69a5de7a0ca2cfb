"""Zero shift of the position sensor: a reading other than zero at mid-stroke."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "sensors"
EQUATION = "x,read = x + bias"
SOURCE = "Doebelin, Measurement Systems: Application and Design, 1966: zero shift"
WORDS = Words(
    "the zero of the position sensor",
    lacking=False,
    inspect="inspect the mounting of the position sensor",
    measure="move the piston to mid-stroke by a gauge and read the sensor",
    change="set the sensor's zero, or give the value as `bias` of `sensors.position` in the rig file",
)


class Parameters(NamedTuple):
    """The zero shift."""

    bias: Annotated[float, quantity("m", "added to the position's reading", minimum=-1.0, maximum=1.0)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the zero of the position sensor shifted."""
    return rig.with_sensors(["position"], lambda sensor: sensor._replace(bias=sensor.bias + parameters.bias))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The bias."""
    return (Form({"bias": ()}),)
