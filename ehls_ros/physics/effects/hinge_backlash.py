"""Free play in the hinge between piston and spring.

With ``gap`` the spring centres what is behind the hinge: around the middle nothing pulls. With ``held_gap`` friction holds
it: the spring stays bent as it is until the play is taken up the other way.
"""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._play import RATE, dead_zone, dragged
from ehls_ros.physics.effects.base import Form, Share, Stage
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import X
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

STAGE: Stage = "mechanics"
EQUATION = "ks x -> ks dz(r, ±gap/2), r dragged by x with a play of held_gap"
SOURCE = "Nordin, Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38, 2002"
STATES = 1


class Parameters(NamedTuple):
    """Free play in all, of a hinge whose far side is free, or held."""

    gap: Annotated[float, quantity("m", "free play, far side centred by the spring", minimum=0.0, maximum=0.1)] = 0.0
    held_gap: Annotated[float, quantity("m", "free play, far side held where it is", minimum=0.0, maximum=0.1)] = 0.0


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Array, plant: Plant) -> float:
    """Replace the spring of (3) by the one behind the play."""
    bent = dead_zone(dragged(z[0], y[X], p[1]), -0.5 * p[0], 0.5 * p[0])
    return value + plant.spring_stiffness * (y[X] - bent)


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Array, plant: Plant, dz: Array) -> None:
    """Remember where the far side was dragged to."""
    dz[0] = RATE * (dragged(z[0], y[X], p[1]) - z[0])


def forms(rig: Rig) -> tuple[Form, ...]:
    """Either play, narrow, middling and wide."""
    starts = tuple(Share("position_m", part) for part in (0.02, 0.1, 0.3))
    return Form({"gap": starts}), Form({"held_gap": starts})
