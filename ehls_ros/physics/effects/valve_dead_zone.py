"""Overlap of the spool's lands: around the centre the valve moves without opening."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import dead_zone
from ehls_ros.physics.effects.base import Form, Share, Stage
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

STAGE: Stage = "valve"
EQUATION = "xv,eff = xv - min(max(xv, -negative), positive)"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 5: overlapped (closed-centre) valve"


class Parameters(NamedTuple):
    """Overlap on either side."""

    positive: Annotated[float, quantity("m", "overlap on the positive side", minimum=0.0, maximum=5e-3)] = 0.0
    negative: Annotated[float, quantity("m", "overlap on the negative side", minimum=0.0, maximum=5e-3)] = 0.0


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Array, plant: Plant) -> float:
    """Take the overlap off."""
    return dead_zone(value, -p[1], p[0])


def forms(rig: Rig) -> tuple[Form, ...]:
    """Both sides, narrow, middling and wide."""
    starts = tuple(Share("spool_m", part) for part in (0.02, 0.1, 0.3))
    return (Form({"positive": starts, "negative": starts}),)
