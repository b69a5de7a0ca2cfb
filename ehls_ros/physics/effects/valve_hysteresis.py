"""The spool follows the command with lost motion: friction and magnetic hysteresis of pilot and torque motor."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import RATE, dragged
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = (
    "u -> mean of ri, plays in parallel: ri stands still while |u - ri| < wi/2 and else is dragged along at that distance; "
    "wi = width (1 - 3/4 spread), (1 - 1/4 spread), (1 + 1/4 spread), (1 + 3/4 spread)"
)
SOURCE = (
    "Visintin, Differential Models of Hysteresis, 1994: play, and plays in parallel after Prandtl and Ishlinskii; "
    "Merritt, Hydraulic Control Systems, 1967, ch. 7: hysteresis"
)
WORDS = Words(
    "a hysteresis of the valve",
    check="drive the valve slowly around null with and without dither; check the oil for contamination",
)
STATES = 4


class Parameters(NamedTuple):
    """Width of the loop of spool over command, and how round its corners are: one play where nothing is spread."""

    width: Annotated[float, quantity("m", "command that a reversal loses", minimum=0.0, maximum=1e-2)] = 0.0
    spread: Annotated[
        float, quantity("1", "how far the plays' widths reach to either side of it", minimum=0.0, maximum=1.0)
    ] = 0.0


@kernel
def width_of(play: int, p: Parameters) -> float:
    """Return the width of one of the plays [m]."""
    return p.width * (1.0 + p.spread * (0.5 * play - 0.75))


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Drag the command after itself."""
    total = 0.0
    for play in range(STATES):
        total += dragged(z[play], value, width_of(play, p))
    return total / STATES


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant, dz: Array) -> None:
    """Remember where it was dragged to."""
    for play in range(STATES):
        dz[play] = RATE * (dragged(z[play], u, width_of(play, p)) - z[play])


def forms(rig: Rig) -> tuple[Form, ...]:
    """Narrow, middling, wide; with sharp corners, or round ones."""
    widths = tuple(Share("valve_command_m", part) for part in (0.02, 0.1, 0.3))
    return Form({"width": widths}), Form({"width": widths, "spread": (0.5, 0.5, 0.5)})
