"""Friction that grows with the load pressure, as the oil presses the seals against their faces."""

import math
from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._level import shifted_level
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
EQUATION = "s(v) -> s(v) + slope (√(pL² + onset²) - onset), slope |pL| far beyond the onset; at least 1 N"
SOURCE = (
    "Bonchis, Corke, Rye, A pressure-based, velocity independent, friction model for asymmetric hydraulic cylinders, ICRA 1999"
)
WORDS = Words(
    "a friction that grows with the pressure",
    check="repeat a slow stroke at several loads; check the type and the fit of the seals",
)


class Parameters(NamedTuple):
    """Friction per pressure; at zero load pressure the rig file's friction applies."""

    slope: Annotated[float, quantity("N/Pa", "Stribeck level per load pressure", minimum=-0.05, maximum=0.05)] = 0.0
    onset: Annotated[float, quantity("Pa", "load pressure above which friction grows linearly", minimum=0.0, maximum=1e7)] = 0.0


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Shift the level with the pressure."""
    return shifted_level(value, p.slope * (math.hypot(y[PL], p.onset) - p.onset))


def forms(rig: Rig) -> tuple[Form, ...]:
    """Without or with an onset."""
    return Form({"slope": ()}), Form({"slope": (), "onset": (5e4, 2e5, 5e5)})
