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
ONLY_IN_CHAMBERS = ("first", "second")
SIDES = {"first": "a", "second": "b"}


class Parameters(NamedTuple):
    """The sensitivity."""

    gain: Annotated[float, quantity("1", "factor on the load pressure's reading", minimum=0.1, maximum=10.0)] = 1.0
    first: Annotated[float, quantity("1", "factor on the reading of the pressure in A", minimum=0.1, maximum=10.0)] = 1.0
    second: Annotated[float, quantity("1", "factor on the reading of the pressure in B", minimum=0.1, maximum=10.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the sensitivity scaled."""
    return rig.with_sensors(["load_pressure"], lambda sensor: sensor._replace(gain=parameters.gain * sensor.gain))


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the sensors of its chambers shifted."""
    rig = rig.with_sensors(["pressure_a"], lambda sensor: sensor._replace(gain=sensor.gain * parameters.first))
    return rig.with_sensors(["pressure_b"], lambda sensor: sensor._replace(gain=sensor.gain * parameters.second))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The gain, of the load pressure or of one chamber."""
    places = ("gain", "first", "second") if rig.cylinder.law.CHAMBERS else ("gain",)
    return tuple(Form({place: ()}) for place in places)
