"""Hysteresis between command and spool: friction and magnetic hysteresis of pilot stage and torque motor."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import FOLLOW_RATE, play_output
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = (
    "u -> mean of ri, plays in parallel: ri is constant while |u - ri| < wi/2 and otherwise follows u at that distance; "
    "wi = width (1 - 3/4 spread), (1 - 1/4 spread), (1 + 1/4 spread), (1 + 3/4 spread)"
)
SOURCE = (
    "Visintin, Differential Models of Hysteresis, 1994: play operator and Prandtl-Ishlinskii model; "
    "Merritt, Hydraulic Control Systems, 1967, ch. 7: hysteresis"
)
WORDS = Words(
    "a hysteresis of the valve",
    inspect="inspect the oil for contamination, and the dither of the amplifier",
    measure="drive the valve slowly around null, with and without dither, and plot spool over command",
    change="keep `valve_hysteresis` under `effects` in the rig file",
)
STATES = 4


class Parameters(NamedTuple):
    """Width of the loop of spool over command, and roundness of its corners; zero spread gives a single play."""

    width: Annotated[float, quantity("m", "change of command lost at a reversal", minimum=0.0, maximum=1e-2)] = 0.0
    spread: Annotated[float, quantity("1", "spread of the plays' widths about it, relative", minimum=0.0, maximum=1.0)] = 0.0


@kernel
def width_of(play: int, p: Parameters) -> float:
    """Return the width of one of the plays [m]."""
    return p.width * (1.0 + p.spread * (0.5 * play - 0.75))


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the mean output of the plays [m]."""
    total = 0.0
    for play in range(STATES):
        total += play_output(z[play], value, width_of(play, p))
    return total / STATES


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    """Write rates that make the states follow the outputs of the plays."""
    for play in range(STATES):
        dz[play] = FOLLOW_RATE * (play_output(z[play], u, width_of(play, p)) - z[play])


def forms(rig: Rig) -> tuple[Form, ...]:
    """The width, with sharp or round corners, and narrow, medium and wide starting values."""
    widths = tuple(Share("valve_command_m", fraction) for fraction in (0.02, 0.1, 0.3))
    return Form({"width": widths}), Form({"width": widths, "spread": (0.5, 0.5, 0.5)})
