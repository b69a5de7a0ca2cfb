"""Spool bandwidth other than in the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "ωv -> factor ωv"
SOURCE = "Kang et al. 2018, (4)"
WORDS = Words(
    "the bandwidth of the valve",
    lacking=False,
    inspect="inspect the pilot supply and its filter",
    measure="measure the valve's frequency response at working pressure and small amplitude",
    change="multiply `valve_bandwidth` in the rig file by the factor",
)


class Parameters(NamedTuple):
    """Factor on the bandwidth."""

    factor: Annotated[float, quantity("1", "factor on the valve's bandwidth", minimum=0.02, maximum=50.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the bandwidth scaled."""
    return rig.with_plant(valve_bandwidth=parameters.factor * rig.plant.valve_bandwidth)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The factor, with slower and faster starting values."""
    return (Form({"factor": (0.5, 2.0)}),)
