"""A force that no named effect explains, as a formula or a table over one of the stage's signals."""

from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._table import DISCREPANCY, looked_up, no_forms, table_parameters, term_rate, term_step
from ehls_ros.physics.effects.base import Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import XV

GROUP: Group = "mechanics"
EQUATION = "F = term(argument)"
SOURCE = DISCREPANCY
WORDS = Words(
    "a force found in the data",
    inspect="look for a mechanism that gives a force of this shape",
    measure="move the piston slowly over the range in which the force acts, and read the load cell",
    change="keep `empirical_force` under `effects` in the rig file until its cause is known",
)
LEARNT = True
STATES = 1
forms, longest_step = no_forms, term_step

Parameters = table_parameters(__name__, "N", "force along +x", 1e6)


@kernel
def force(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> float:
    """Add the force."""
    return value + looked_up(y[XV], t, y, w, z, p)


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant, dz: Array) -> None:
    """Write the rate of the term's state."""
    dz[0] = term_rate(y[XV], t, y, w, z, p)
