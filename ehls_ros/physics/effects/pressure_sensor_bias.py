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
ONLY_IN_CHAMBERS = ("first", "second")
SIDES = {"first": "a", "second": "b"}


class Parameters(NamedTuple):
    """The zero shift."""

    bias: Annotated[float, quantity("Pa", "added to the load pressure's reading", minimum=-1e7, maximum=1e7)] = 0.0
    first: Annotated[float, quantity("Pa", "added to the reading of the pressure in A", minimum=-1e7, maximum=1e7)] = 0.0
    second: Annotated[float, quantity("Pa", "added to the reading of the pressure in B", minimum=-1e7, maximum=1e7)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the zero shifted."""
    return rig.with_sensors(["load_pressure"], lambda sensor: sensor._replace(bias=sensor.bias + parameters.bias))


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the sensors of its chambers shifted."""
    rig = rig.with_sensors(["pressure_a"], lambda sensor: sensor._replace(bias=sensor.bias + parameters.first))
    return rig.with_sensors(["pressure_b"], lambda sensor: sensor._replace(bias=sensor.bias + parameters.second))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The bias, of the load pressure or of one chamber."""
    places = ("bias", "first", "second") if rig.cylinder.law.CHAMBERS else ("bias",)
    return tuple(Form({place: ()}) for place in places)
