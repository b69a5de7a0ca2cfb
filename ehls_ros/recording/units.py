"""Units of recorded signals, as written in the headers of measured data."""

from ehls_ros import units
from ehls_ros.trajectory import READABLE
from ehls_ros.units import QUANTITIES, UNITS

ELECTRICAL = ("current", "voltage", "ratio", "counts")
"""Quantities that represent another one through the gain of a converter, an amplifier or a valve."""

NEVER_RECORDED = ("area", "volume", "mass", "density", "stiffness", "damping")
"""Quantities that occur only in rig files: ``t`` above a column is the time, not tonnes."""

RECORDED = tuple(name for name, unit in UNITS.items() if unit.quantity not in NEVER_RECORDED)
"""Permitted units of a column."""


def quantity_of(name: str) -> str:
    """Return the quantity of a name in the data contract; empty if its unit is in no list."""
    return "time" if name == "time_s" else QUANTITIES.get(READABLE[name].unit, "") if name in READABLE else ""


def unit_of(text: str) -> str | None:
    """Return the standard spelling of a column's unit; None if it is not a permitted unit."""
    known = units.unit_of(text)
    return known if known in RECORDED else None
