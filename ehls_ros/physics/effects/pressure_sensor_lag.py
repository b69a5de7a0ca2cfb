"""The load pressure sensors lag: long lines, air in them, a filter; the load cell is not affected."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Sensor
from ehls_ros.physics.rig import CHAMBER_SENSED, Rig
from ehls_ros.schema import quantity

GROUP: Group = "sensors"
EQUATION = "time_constant p' = pL - p; it adds to the sensor's own time constant"
SOURCE = "Doebelin, Measurement Systems: Application and Design, 1966: first-order instruments"
WORDS = Words(
    "a lag of the load pressure sensor",
    inspect="inspect the sensors' lines for air, and the filters of their amplifiers",
    measure="record a step of pressure together with a sensor mounted at the cylinder",
    change="bleed the lines, or give 1 / time constant as `bandwidth` of `sensors.load_pressure` in the rig file",
)


class Parameters(NamedTuple):
    """The lag."""

    time_constant: Annotated[
        float, quantity("s", "time constant added to the load pressure's reading", minimum=0.0, maximum=1.0)
    ] = 0.0


def lagging(sensor: Sensor, by: float) -> Sensor:
    """Return a sensor with both time constants added [s], the low-frequency equivalent of two lags in series."""
    total = by + (1.0 / sensor.bandwidth if sensor.bandwidth > 0.0 else 0.0)
    return sensor._replace(bandwidth=1.0 / total if total > 0.0 else 0.0)


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the lag of the load pressure's sensor."""
    return rig.with_sensors(["load_pressure"], lambda sensor: lagging(sensor, parameters.time_constant))


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the same lag of both chambers' sensors."""
    return rig.with_sensors(CHAMBER_SENSED, lambda sensor: lagging(sensor, parameters.time_constant))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The time constant, with short, medium and long starting values."""
    return (Form({"time_constant": (0.002, 0.01, 0.05)}),)
