"""The spool follows the command with lost motion: friction and magnetic hysteresis of pilot and torque motor."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import RATE, dragged
from ehls_ros.physics.effects.base import Form, Share, Stage
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

STAGE: Stage = "valve"
EQUATION = "play: u -> r, which stands still while |u - r| < width/2 and else is dragged along at that distance"
SOURCE = "Visintin, Differential Models of Hysteresis, 1994: play; Merritt, Hydraulic Control Systems, 1967, ch. 7: hysteresis"
STATES = 1


class Parameters(NamedTuple):
    """Width of the loop of spool over command."""

    width: Annotated[float, quantity("m", "command that a reversal takes to move the spool", minimum=0.0, maximum=1e-2)] = 0.0


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Array, plant: Plant) -> float:
    """Drag the command after itself."""
    return dragged(z[0], value, p[0])


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Array, plant: Plant, dz: Array) -> None:
    """Remember where it was dragged to."""
    dz[0] = RATE * (dragged(z[0], u, p[0]) - z[0])


def forms(rig: Rig) -> tuple[Form, ...]:
    """Narrow, middling, wide."""
    return (Form({"width": tuple(Share("valve_command_m", part) for part in (0.02, 0.1, 0.3))}),)
