"""The pressure at the valve's port T is not that of the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "p_T -> p_T + added, at least 0"
SOURCE = "Jelali, Kroll, Hydraulic Servo-systems, 2003, ch. 4: flow through the edges to the tank"
WORDS = Words(
    "the tank pressure",
    lacking=False,
    inspect="inspect the return line, its filter and its check valve",
    measure="read a gauge at the valve's port T during a fast stroke",
    change="add the fitted value to `tank_pressure` of the cylinder in the rig file",
)


class Parameters(NamedTuple):
    """Change of the tank pressure."""

    added: Annotated[float, quantity("Pa", "added to the tank pressure", minimum=-1e7, maximum=1e7)] = 0.0


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the tank pressure shifted."""
    return rig.with_cylinder(tank_pressure=max(rig.cylinder.parameters.tank_pressure + parameters.added, 0.0))


def forms(rig: Rig) -> tuple[Form, ...]:
    """The change."""
    return (Form({"added": ()}),) if rig.cylinder.law.CHAMBERS else ()
