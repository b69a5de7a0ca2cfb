"""An opening of the valve that no named effect explains, as a table over one of the stage's signals."""

from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._table import DISCREPANCY, looked_up, no_forms, table_parameters
from ehls_ros.physics.effects.base import Group, Words
from ehls_ros.physics.parameters import Plant

GROUP: Group = "flow"
EQUATION = "xv,eff = xv + table(argument)"
SOURCE = DISCREPANCY
WORDS = Words(
    "a metering of the valve found in the data",
    inspect="look for a wear or a shape of the metering edges that gives an opening of this shape",
    measure="measure the flow without load over the command",
    change="keep `empirical_opening` under `effects` in the rig file until its cause is known",
)
LEARNT = True
forms = no_forms

Parameters = table_parameters(__name__, "m", "change of the effective opening", 1e-2)


@kernel
def opening(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> float:
    """Change the opening."""
    return value + looked_up(value, t, y, w, p)
