"""Leakage from the chambers to the outside, past the rod seals."""

from typing import Annotated, NamedTuple

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import chamber_pressures
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "leakage -> leakage + ((first + each) p1 - (second + each) p2)/2,  p1,2 = (ps ± pL)/2"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 6: external leakage in the volume balances of both chambers"
WORDS = Words(
    "a leakage to the outside",
    inspect="look for oil at rod seals, fittings and drain lines",
    measure="hold the piston under pressure and measure what drips within some minutes",
    change="keep `external_leakage` under `effects` in the rig file until the leak is sealed",
)
SIDES = {"first": "a", "second": "b", "each": "both"}


class Parameters(NamedTuple):
    """Leakage coefficients of the first chamber, the second chamber, and both equally."""

    first: Annotated[float, quantity("m^5/(N s)", "leakage of the chamber that drives +x", minimum=0.0, maximum=1e-9)] = 0.0
    second: Annotated[float, quantity("m^5/(N s)", "leakage of the chamber that drives -x", minimum=0.0, maximum=1e-9)] = 0.0
    each: Annotated[float, quantity("m^5/(N s)", "leakage of each chamber, equal for both", minimum=0.0, maximum=1e-9)] = 0.0


@kernel
def leakage(value: float, t: float, y: Array, w: Array, z: Array, p: Parameters, plant: Plant) -> float:
    """Add half the difference of the two leakage flows, since (2) is half the sum of the chambers' balances."""
    first, second = chamber_pressures(y, plant)
    return value + 0.5 * ((p.first + p.each) * first - (p.second + p.each) * second)


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the leakages added to those of its chambers."""
    own, p = rig.cylinder.parameters, parameters
    return rig.with_cylinder(leakage_a=own.leakage_a + p.first + p.each, leakage_b=own.leakage_b + p.second + p.each)


def forms(rig: Rig) -> tuple[Form, ...]:
    """Leakage of the first chamber, the second, or both."""
    return Form({"first": ()}), Form({"second": ()}), Form({"each": ()})
