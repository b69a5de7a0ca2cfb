"""An opening of the valve that no named effect explains, as a formula or a table over one of the stage's signals."""

from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._table import DISCREPANCY, looked_up, no_forms, table_parameters, term_rate, term_step
from ehls_ros.physics.effects.base import Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import XV

GROUP: Group = "flow"
EQUATION = "xv,eff = xv + term(argument)"
SOURCE = DISCREPANCY
WORDS = Words(
    "a metering of the valve found in the data",
    inspect="look for a wear or a shape of the metering edges that gives an opening of this shape",
    measure="measure the flow without load over the command",
    change="keep `empirical_opening` under `effects` in the rig file until its cause is known",
)
LEARNT = True
STATES = 1
forms, longest_step = no_forms, term_step

Parameters = table_parameters(__name__, "m", "change of the effective opening", 1e-2)


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> float:
    """Change the opening."""
    return value + looked_up(value, t, y, w, z, p)


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant, dz: Array) -> None:
    """Write the rate of the term's state."""
    dz[0] = term_rate(y[XV], t, y, w, z, p)
