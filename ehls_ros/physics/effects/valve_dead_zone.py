"""Overlap of the spool's lands: around null the spool moves without opening the orifice."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import dead_zone, ramp
from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = (
    "xv,eff = xv - min(max(xv, -negative), positive); corners as c ln(1 + exp(d/c)), d beyond them, "
    "c = rounding (positive + negative)/2"
)
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 5: overlapped (closed-centre) valve"
WORDS = Words(
    "a dead zone of the valve",
    inspect="inspect the spool's lap in the valve's data sheet",
    measure="raise the command slowly through null in both directions and note where the piston starts",
    change="keep `valve_dead_zone` under `effects` in the rig file, or compensate it in the amplifier",
)


class Parameters(NamedTuple):
    """Overlap on each side."""

    positive: Annotated[float, quantity("m", "overlap on the positive side", minimum=0.0, maximum=5e-3)] = 0.0
    negative: Annotated[float, quantity("m", "overlap on the negative side", minimum=0.0, maximum=5e-3)] = 0.0
    rounding: Annotated[
        float, quantity("1", "fraction of the mean overlap over which worn edges open gradually", minimum=0.0, maximum=1.0)
    ] = 0.0


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Subtract the overlap."""
    corner = 0.5 * p.rounding * (p.positive + p.negative)
    if corner <= 0.0:
        return dead_zone(value, -p.negative, p.positive)
    return ramp(value - p.positive, corner) - ramp(-value - p.negative, corner)


def forms(rig: Rig) -> tuple[Form, ...]:
    """Both sides, with sharp or worn edges, and narrow, medium and wide starting values."""
    starts = tuple(Share("spool_m", fraction) for fraction in (0.02, 0.1, 0.3))
    sides = {"positive": starts, "negative": starts}
    return Form(sides), Form({**sides, "rounding": (0.1, 0.1, 0.1)})
