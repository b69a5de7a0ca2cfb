"""The load pressure sensors read too high or too low; the load cell is not affected."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "sensors"
EQUATION = "pL,read = gain pL"
SOURCE = "Doebelin, Measurement Systems: Application and Design, 1966: sensitivity"
WORDS = Words(
    "the gain of the load pressure sensor",
    lacking=False,
    inspect="inspect ranges and scaling of both pressure sensors, and whether they are exchanged",
    measure="compare both pressure sensors with a reference gauge at two pressures",
    change="correct the scaling, or give the factor as `gain` of `sensors.load_pressure` in the rig file",
)


class Parameters(NamedTuple):
    """The sensitivity."""

    gain: Annotated[float, quantity("1", "factor on the load pressure's reading", minimum=0.1, maximum=10.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the sensitivity scaled."""
    return rig.with_sensors(["load_pressure"], lambda sensor: sensor._replace(gain=parameters.gain * sensor.gain))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The gain."""
    return (Form({"gain": ()}),)
