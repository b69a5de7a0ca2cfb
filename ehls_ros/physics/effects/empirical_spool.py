"""A command of the spool that no named effect explains, as a formula or a table over one of the stage's signals."""

from typing import Any

from ehls_ros.arrays import Array, kernel
from ehls_ros.physics.effects._table import DISCREPANCY, looked_up, no_forms, table_parameters, term_rate, term_step
from ehls_ros.physics.effects.base import Group, Words
from ehls_ros.physics.parameters import Plant

GROUP: Group = "valve"
EQUATION = "u -> u + term(argument)"
SOURCE = DISCREPANCY
WORDS = Words(
    "a command error found in the data",
    inspect="look for an amplifier or a spool that answers with this shape",
    measure="record the spool while the command rises slowly through its range",
    change="keep `empirical_spool` under `effects` in the rig file until its cause is known",
)
LEARNT = True
STATES = 1
forms, longest_step = no_forms, term_step

Parameters = table_parameters(__name__, "m", "change of the command that the spool follows", 1e-2)


@kernel
def command(value: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant) -> float:
    """Change the command."""
    return value + looked_up(value, t, y, w, z, p)


@kernel
def derivatives(u: float, t: float, y: Array, w: Array, z: Array, p: Any, plant: Plant, dz: Array) -> None:
    """Write the rate of the term's state."""
    dz[0] = term_rate(u, t, y, w, z, p)
