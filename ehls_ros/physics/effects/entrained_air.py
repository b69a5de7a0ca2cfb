"""Undissolved air in the oil: higher compliance at low pressure.

Air in the chambers is compressed by the chamber pressures; (2) uses the mean of the two compliances. Air of ``load`` is in a
volume compressed by |pL| alone.
"""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
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

ATMOSPHERE = 101325.0
"""Atmospheric pressure p0, at which gauges read zero [Pa]."""

NOT_IN_CHAMBERS = ("load",)

POLYTROPIC = 1.4
"""Polytropic exponent n of compression too fast for heat exchange."""


class Parameters(NamedTuple):
    """Volume fraction of air at atmospheric pressure."""

    chambers: Annotated[float, quantity("1", "fraction of air in both chambers", minimum=0.0, maximum=0.2)] = 0.0
    load: Annotated[float, quantity("1", "fraction of air in a volume compressed by |pL|", minimum=0.0, maximum=0.2)] = 0.0


@kernel
def compliance(gauge: float) -> float:
    """Return the compliance per volume fraction of air at a gauge pressure [1/Pa]."""
    pressure = ATMOSPHERE + gauge
    return (ATMOSPHERE / pressure) ** (1.0 / POLYTROPIC) / (POLYTROPIC * pressure)


@kernel
def bulk_modulus(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add the compliance of the air to that of the oil."""
    first, second = chamber_pressures(y, plant)
    air = p.chambers * 0.5 * (compliance(first) + compliance(second)) + p.load * compliance(abs(y[PL]))
    return value / (1.0 + value * air)


@kernel
def chamber_modulus(
    value: float, pressure: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant
) -> float:
    """Add the compliance of the air in a chamber to that of the oil in it."""
    return value / (1.0 + value * p.chambers * compliance(pressure))


def forms(rig: Rig) -> tuple[Form, ...]:
    """Air in the chambers or in the load volume, each with a low and a high starting value."""
    return Form({"chambers": (0.005, 0.03)}), Form({"load": (0.005, 0.03)})
