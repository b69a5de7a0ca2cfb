"""The command reaches the valve late: converter, fieldbus or a slow cycle. Of two in a rig, the last in the list applies."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.duals import value_of
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import INPUTS, PERIOD, START
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "u(t) -> u(t - delay)"
SOURCE = "Åström, Wittenmark, Computer-Controlled Systems, 1997: delays that are no whole number of periods"
WORDS = Words(
    "a delay of the command",
    inspect="inspect the path from controller to valve: cycle time, field bus, converter",
    measure="record a step of the command and the valve's input voltage with one oscilloscope",
    change="keep `command_delay` under `effects` in the rig file, or shorten the path",
)
REACH = 0.05

ROUNDING = 1e-7
"""Tolerance within which times are equal, as a fraction of the control period."""


class Parameters(NamedTuple):
    """The delay."""

    delay: Annotated[float, quantity("s", "delay from controller to valve", minimum=0.0, maximum=REACH)] = 0.0


@kernel
def received(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Return the command that was sent one delay ago."""
    ago = math.ceil((p.delay - (t - w[START])) / w[PERIOD] - ROUNDING)
    known = w.size - INPUTS
    return w[INPUTS + min(ago, known) - 1] if ago > 0 and known > 0 else value


@kernel
def jump(t: float, w: Array, p: Parameters) -> float:
    """Return the arrival time of the next of the commands sent so far [s]."""
    left = p.delay - (t - w[START])
    if left <= ROUNDING * w[PERIOD]:
        return math.inf
    after = left - math.floor(left / w[PERIOD]) * w[PERIOD]
    return t + (after if after > ROUNDING * w[PERIOD] else w[PERIOD])


def reach(p: Parameters) -> float:
    """Return the delay [s]."""
    return float(value_of(p.delay))


def corner(p: Parameters, period: float, varied: bool) -> str:
    """Return why readings have no derivative by the delay: at whole periods, commands arrive at the sampling instants."""
    cycles = p.delay / period
    whole = varied and abs(cycles - round(cycles)) <= ROUNDING
    return f"a delay of {round(cycles)} whole control periods, where the derivative jumps" if whole else ""


def forms(rig: Rig) -> tuple[Form, ...]:
    """Delay, with short, medium and long starting values."""
    return (Form({"delay": (0.001, 0.004, 0.012)}),)
