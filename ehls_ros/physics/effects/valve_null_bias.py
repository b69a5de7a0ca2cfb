"""The valve's hydraulic centre is not where zero command, or the spool's sensor, has it."""

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
    check="re-null the valve warm and at working pressure; check the zero of its amplifier and of the spool sensor",
)


class Parameters(NamedTuple):
    """Where the bias sits: before the spool, or between its sensor and the lands."""

    command: Annotated[float, quantity("m", "what is added to the command", minimum=-1e-2, maximum=1e-2)] = 0.0
    opening: Annotated[float, quantity("m", "what the orifice is open beyond the spool", minimum=-1e-2, maximum=1e-2)] = 0.0


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the command."""
    return value + p.command


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the lands."""
    return value + p.opening


def forms(rig: Rig) -> tuple[Form, ...]:
    """Either."""
    return Form({"command": ()}), Form({"opening": ()})
