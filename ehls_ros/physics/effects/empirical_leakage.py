"""A leakage that no named effect explains, as a formula or a table over one of the stage's signals."""

from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._table import DISCREPANCY, looked_up, no_forms, table_parameters, term_rate, term_step
from ehls_ros.physics.effects.base import Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import XV

GROUP: Group = "flow"
EQUATION = "q -> q + term(argument)"
SOURCE = DISCREPANCY
WORDS = Words(
    "a leakage found in the data",
    inspect="look for a seal or a valve that opens with this shape",
    measure="close the valve, load the piston, and measure its drift over the load",
    change="keep `empirical_leakage` under `effects` in the rig file until its cause is known",
)
LEARNT = True
STATES = 1
forms, longest_step = no_forms, term_step

Parameters = table_parameters(__name__, "m^3/s", "further leakage", 1e-1)


@kernel
def leakage(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> float:
    """Add the leakage."""
    return value + looked_up(y[XV], t, y, w, z, p)


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant, dz: Array) -> None:
    """Write the rate of the term's state."""
    dz[0] = term_rate(y[XV], t, y, w, z, p)
