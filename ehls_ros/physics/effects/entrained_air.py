"""Undissolved air in the oil: higher compliance at low pressure.

Air in the chambers is compressed by the chamber pressures; (2) uses the mean of the two compliances. Air of ``load`` is in a
volume compressed by |pL| alone.
"""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.equations import air_compliance
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import PL, chamber_pressures
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "1/βe -> 1/βe + fraction (p0/p)^(1/n)/(n p), p absolute, p0 atmospheric, n = 1.4"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 2: 1/βe = 1/βl + (Vg/Vt)/(n p), with Vg compressed polytropically"
WORDS = Words(
    "air in the oil",
    inspect="inspect the reservoir's level, the suction line, and the return for foam",
    measure="bleed the cylinder and record again: the effect must get smaller",
    change="keep `entrained_air` under `effects` in the rig file only if bleeding does not remove it",
)

NOT_IN_CHAMBERS = ("load",)
SIDES = {"chambers": "both", "first": "a", "second": "b"}


class Parameters(NamedTuple):
    """Volume fraction of air at atmospheric pressure."""

    chambers: Annotated[float, quantity("1", "fraction of air in both chambers", minimum=0.0, maximum=0.2)] = 0.0
    load: Annotated[float, quantity("1", "fraction of air in a volume compressed by |pL|", minimum=0.0, maximum=0.2)] = 0.0
    first: Annotated[float, quantity("1", "fraction in the chamber that drives +x, added", minimum=0.0, maximum=0.2)] = 0.0
    second: Annotated[float, quantity("1", "fraction in the chamber that drives -x, added", minimum=0.0, maximum=0.2)] = 0.0


@kernel
def bulk_modulus(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the compliance of the air to that of the oil."""
    first, second = chamber_pressures(y, plant)
    of_first, of_second = air_compliance(first), air_compliance(second)
    air = p.chambers * 0.5 * (of_first + of_second) + p.load * air_compliance(abs(y[PL]))
    return value / (1.0 + value * (air + 0.5 * (p.first * of_first + p.second * of_second)))


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the air added to that in its chambers."""
    own, p = rig.cylinder.parameters, parameters
    return rig.with_cylinder(air_a=own.air_a + p.chambers + p.first, air_b=own.air_b + p.chambers + p.second)


def forms(rig: Rig) -> tuple[Form, ...]:
    """Air in both chambers, in one of them, or in the load volume, each with a low and a high starting value."""
    places = ("chambers", "first", "second") if rig.cylinder.law.CHAMBERS else ("chambers", "load")
    return tuple(Form({place: (0.005, 0.03)}) for place in places)
