"""A valve gain that differs between the two directions."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "u -> (1 + command_±) u,  xv,eff = (1 + opening_±) xv,  by the sign of u and of xv"
SOURCE = "Jelali, Kroll, Hydraulic Servo-systems, 2003: flow gains of a servo valve that differ by direction"
WORDS = Words(
    "a valve gain that differs between the directions",
    inspect="look for worn edges on one side of the spool",
    measure="apply the same command in both directions and compare the piston's speeds",
    change="keep `valve_gain_asymmetry` under `effects` in the rig file",
)


class Parameters(NamedTuple):
    """Relative changes of the gain from command to spool, and from spool to open area."""

    command_positive: Annotated[float, quantity("1", "change of the spool's gain, u > 0", minimum=-0.95, maximum=5.0)] = 0.0
    command_negative: Annotated[float, quantity("1", "change of the spool's gain, u < 0", minimum=-0.95, maximum=5.0)] = 0.0
    opening_positive: Annotated[float, quantity("1", "change of the open area, xv > 0", minimum=-0.95, maximum=5.0)] = 0.0
    opening_negative: Annotated[float, quantity("1", "change of the open area, xv < 0", minimum=-0.95, maximum=5.0)] = 0.0


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Scale the command by its sign."""
    return value * (1.0 + (p.command_positive if value > 0.0 else p.command_negative))


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Scale the opening by its sign."""
    return value * (1.0 + (p.opening_positive if value > 0.0 else p.opening_negative))


def forms(rig: Rig) -> tuple[Form, ...]:
    """Gains by sign of the command, or of the opening."""
    return (
        Form({"command_positive": (), "command_negative": ()}),
        Form({"opening_positive": (), "opening_negative": ()}),
    )
