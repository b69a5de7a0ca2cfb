"""The valve saturates: its amplifier or stroke reaches the limit, or its ports are fully open."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import clamp
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "u -> min(max(u, -command_limit), command_limit);  xv,eff = min(max(xv, -opening_limit), opening_limit)"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 10: saturation"
WORDS = Words(
    "a saturation of the valve",
    inspect="inspect the amplifier's output limit and the spool's stroke",
    measure="raise the command slowly and note where the spool or the piston's speed stops rising",
    change="keep `valve_saturation` under `effects` in the rig file, and set `limits.spool` to it",
)


class Parameters(NamedTuple):
    """Limits of command and opening; the default of one metre is beyond any valve."""

    command_limit: Annotated[float, quantity("m", "largest command the spool follows", minimum=1e-6, maximum=1.0)] = 1.0
    opening_limit: Annotated[float, quantity("m", "largest opening of the orifice", minimum=1e-6, maximum=1.0)] = 1.0


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Limit the command."""
    return clamp(value, -p.command_limit, p.command_limit)


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Limit the opening."""
    return clamp(value, -p.opening_limit, p.opening_limit)


def forms(rig: Rig) -> tuple[Form, ...]:
    """One of the two limits, with starts reached rarely, sometimes, often, and nearly always.

    Where the rest of the recording is not judged, as beyond the baselines' range, only the last are reached in what is.
    """
    fractions = (0.97, 0.85, 0.6, 0.3, 0.15)
    return (
        Form({"command_limit": tuple(Share("valve_command_m", fraction) for fraction in fractions)}),
        Form({"opening_limit": tuple(Share("spool_m", fraction) for fraction in fractions)}),
    )
