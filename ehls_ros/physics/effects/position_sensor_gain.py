"""The position sensor reads too high or too low."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "sensors"
EQUATION = "x,read = gain x"
SOURCE = "Doebelin, Measurement Systems: Application and Design, 1966: sensitivity"
WORDS = Words(
    "the gain of the position sensor",
    lacking=False,
    inspect="inspect the scaling of the position sensor and of its amplifier",
    measure="compare two positions with a gauge block or a dial gauge",
    change="correct the scaling, or give the factor as `gain` of `sensors.position` in the rig file",
)


class Parameters(NamedTuple):
    """The sensitivity."""

    gain: Annotated[float, quantity("1", "factor on the position's reading", minimum=0.1, maximum=10.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the sensitivity scaled."""
    return rig.with_sensors(["position"], lambda sensor: sensor._replace(gain=parameters.gain * sensor.gain))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The gain."""
    return (Form({"gain": ()}),)
