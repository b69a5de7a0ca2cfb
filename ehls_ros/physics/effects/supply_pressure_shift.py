"""The supply pressure at rest is not that of the rig file.

Without a reading of the supply pressure, a change of the valve's flow gain has nearly the same effect.
"""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

NEEDS = ("supply_pressure_pa",)
GROUP: Group = "flow"
EQUATION = "ps -> factor ps"
SOURCE = (
    "Merritt, Hydraulic Control Systems, 1967, ch. 5: the valve's flow depends on the supply pressure less the load pressure"
)
WORDS = Words(
    "the supply pressure",
    lacking=False,
    inspect="inspect the setting of the pump's compensator or relief valve, its filter and the accumulator's charge",
    measure="read a gauge at the valve's port P at rest",
    change="multiply `supply_pressure` in the rig file by the factor, unless the pump is set anew",
)


class Parameters(NamedTuple):
    """Factor on the supply pressure."""

    factor: Annotated[float, quantity("1", "factor on the supply pressure", minimum=0.1, maximum=10.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the supply pressure scaled."""
    return rig.with_plant(supply_pressure=parameters.factor * rig.plant.supply_pressure)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The factor."""
    return (Form({"factor": ()}),)
