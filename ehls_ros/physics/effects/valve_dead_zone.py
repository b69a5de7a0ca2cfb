"""Overlap of the spool's lands: around the centre the valve moves without opening."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Stage
from ehls_ros.schema import quantity

STAGE: Stage = "valve"
EQUATION = "xv,eff = xv - min(max(xv, -negative), positive)"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 5: overlapped (closed-centre) valve"


class Parameters(NamedTuple):
    """Overlap on either side."""

    positive: Annotated[float, quantity("m", "overlap on the positive side", minimum=0.0, maximum=1e-3)] = 0.0
    negative: Annotated[float, quantity("m", "overlap on the negative side", minimum=0.0, maximum=1e-3)] = 0.0


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Array) -> float:
    """Take the overlap off."""
    return value - min(max(value, -p[1]), p[0])
