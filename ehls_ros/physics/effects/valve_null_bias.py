"""The valve's hydraulic null is off zero command, or off the zero of the spool sensor."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "u -> u + command;  xv,eff = xv + opening"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 7: null shift of servo valves"
WORDS = Words(
    "a null bias of the valve",
    inspect="inspect the zeros of the amplifier and of the spool sensor",
    measure="find the command at which the piston stands still, warm and at working pressure",
    change="re-null the valve, or keep `valve_null_bias` under `effects` in the rig file",
)


class Parameters(NamedTuple):
    """Bias of the command, or between spool sensor and lands."""

    command: Annotated[float, quantity("m", "offset of the command", minimum=-1e-2, maximum=1e-2)] = 0.0
    opening: Annotated[float, quantity("m", "offset of the opening from the spool reading", minimum=-1e-2, maximum=1e-2)] = 0.0


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the command."""
    return value + p.command


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the opening."""
    return value + p.opening


def forms(rig: Rig) -> tuple[Form, ...]:
    """One of the two biases."""
    return Form({"command": ()}), Form({"opening": ()})
