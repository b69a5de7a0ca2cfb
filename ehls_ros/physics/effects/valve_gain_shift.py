"""The gain from command to spool, or from spool to flow, differs from the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "Kv -> gain Kv;  Cd -> flow_gain Cd"
SOURCE = "Kang et al. 2018, (1) and (4)"
WORDS = Words(
    "the gain of the valve",
    lacking=False,
    inspect="inspect the amplifier's scaling, the spool's stroke and the valve's rated flow",
    measure="measure the piston's speed at a known command and pressure drop",
    change="multiply `valve_gain` by the gain and `discharge_coefficient` by the flow gain in the rig file",
)


class Parameters(NamedTuple):
    """Factors on both gains."""

    gain: Annotated[float, quantity("1", "factor on the spool displacement per command", minimum=0.05, maximum=20.0)] = 1.0
    flow_gain: Annotated[float, quantity("1", "factor on the discharge coefficient", minimum=0.05, maximum=20.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with both gains scaled."""
    plant = rig.plant
    return rig.with_plant(
        valve_gain=parameters.gain * plant.valve_gain,
        discharge_coefficient=parameters.flow_gain * plant.discharge_coefficient,
    )


def forms(rig: Rig) -> tuple[Form, ...]:
    """One of the two gains."""
    return Form({"gain": ()}), Form({"flow_gain": ()})
