"""The friction contact is stiffer or softer before it slips than identified."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects._friction import STIFFNESSES, has, stiffened
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "friction"
SHIFTS = STIFFNESSES
EQUATION = "k_i -> factor k_i, or σ0 -> factor σ0"
SOURCE = "Kang et al. 2018, (6)"
WORDS = Words(
    "the presliding stiffness",
    lacking=False,
    inspect="inspect the seals: they stiffen with age and pressure",
    measure="record small slow oscillations about one position and read the slope of force over travel",
    change="multiply the presliding stiffness in the rig file by the factor, or identify it again by `ehls identify`",
)

NEXT = 1.2
"""Ratio of neighbouring starting values.

Origin: the loss of a truth_generator recording has its valley within 15 % of the true factor, and lesser ones beside it.
"""


class Parameters(NamedTuple):
    """Factor on the stiffness of all elements."""

    factor: Annotated[float, quantity("1", "factor on the presliding stiffness", minimum=0.02, maximum=50.0)] = 1.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the stiffness scaled."""
    return stiffened(rig, parameters.factor)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The factor, with starting values in steps of :data:`NEXT`."""
    starts = tuple(NEXT**k for k in range(-9, 10) if k)
    return (Form({"factor": starts}),) if has(rig, *SHIFTS) else ()
