"""Units of recorded signals, as the headers of measured data write them."""

from ehls_ros import units
from ehls_ros.trajectory import READABLE
from ehls_ros.units import QUANTITIES, UNITS

ELECTRICAL = ("current", "voltage", "ratio", "counts")
"""Quantities that stand for another by a gain: a converter's, an amplifier's, a valve's."""

NEVER_RECORDED = ("area", "volume", "mass", "density", "stiffness", "damping")
"""Quantities of rigs alone: ``t`` above a column is the time, not tonnes."""

RECORDED = tuple(name for name, unit in UNITS.items() if unit.quantity not in NEVER_RECORDED)
"""The units that a column may have."""


def quantity_of(name: str) -> str:
    """Return the quantity that a name of the data contract stands for; the empty text where no unit list has it."""
    return "time" if name == "time_s" else QUANTITIES.get(READABLE[name].unit, "") if name in READABLE else ""


def unit_of(text: str) -> str | None:
    """Return the known spelling of a column's unit; None for what is none."""
    known = units.unit_of(text)
    return known if known in RECORDED else None
