"""A change of friction that no named effect explains, as a formula or a table over one of the stage's signals."""

from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._friction import shifted_level
from ehls_ros.physics.effects._table import DISCREPANCY, looked_up, no_forms, table_parameters, term_rate, term_step
from ehls_ros.physics.effects.base import Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import XV

GROUP: Group = "friction"
EQUATION = "s -> s + term(argument), at least 1 N"
SOURCE = DISCREPANCY
WORDS = Words(
    "a friction found in the data",
    inspect="look for a wear, a fit or a seal that gives a friction of this shape",
    measure="record slow strokes in both directions over the range in which it acts",
    change="keep `empirical_friction` under `effects` in the rig file until its cause is known",
)
LEARNT = True
STATES = 1
forms, longest_step = no_forms, term_step

Parameters = table_parameters(__name__, "N", "change of the Stribeck level", 1e5)


@kernel
def friction_level(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> float:
    """Shift the level."""
    return shifted_level(value, looked_up(y[XV], t, y, w, z, p))


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant, dz: Array) -> None:
    """Write the rate of the term's state."""
    dz[0] = term_rate(y[XV], t, y, w, z, p)
