"""An error of the load pressure sensor that no named effect explains, as a formula or a table over one of the rig's signals."""

from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._table import DISCREPANCY, looked_up, no_forms, table_parameters, term_rate, term_step
from ehls_ros.physics.effects.base import Group, Words
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.plant import XV

GROUP: Group = "sensors"
EQUATION = "pL,read = pL + term(argument)"
SOURCE = DISCREPANCY
WORDS = Words(
    "an error of the load pressure sensor found in the data",
    inspect="inspect mounting, supply and linearity of both pressure sensors",
    measure="compare both pressure sensors with a reference gauge over the range in which the error changes",
    change="repair or calibrate the sensor; until then, keep `empirical_pressure_reading` under `effects` in the rig file",
)
LEARNT = True
STATES = 1
forms, longest_step = no_forms, term_step

Parameters = table_parameters(__name__, "Pa", "error of the reading", 1e8)


@kernel
def pressure_reading(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> float:
    """Add the error."""
    return value + looked_up(y[XV], t, y, w, z, p)


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant, dz: Array) -> None:
    """Write the rate of the term's state."""
    dz[0] = term_rate(y[XV], t, y, w, z, p)
