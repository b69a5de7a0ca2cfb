"""Units as they stand in the headers of measured data, and their SI values.

The list is closed. A library of all units reads ``Nm`` as a number times a metre, ``C`` as coulombs, ``bar(g)`` as bar times
grams and ``1/min`` as a frequency, and does not tell an angle from a ratio or a count.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from ehls_ros.trajectory import READABLE


class Unit(NamedTuple):
    """A unit: the SI value is ``scale`` times the number plus ``offset``.

    Attributes:
        quantity: what it measures.
        scale: SI units per unit.
        offset: SI value of zero.
    """

    quantity: str
    scale: float
    offset: float = 0.0


POUND_FORCE, INCH = 4.4482216152605, 0.0254
"""In newtons and metres, by definition."""

DEGREE = 0.017453292519943295

UNITS: Mapping[str, Unit] = {
    "s": Unit("time", 1.0),
    "sec": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "us": Unit("time", 1e-6),
    "µs": Unit("time", 1e-6),
    "ns": Unit("time", 1e-9),
    "min": Unit("time", 60.0),
    "h": Unit("time", 3600.0),
    "m": Unit("length", 1.0),
    "dm": Unit("length", 0.1),
    "cm": Unit("length", 1e-2),
    "mm": Unit("length", 1e-3),
    "um": Unit("length", 1e-6),
    "µm": Unit("length", 1e-6),
    "in": Unit("length", INCH),
    "m/s": Unit("velocity", 1.0),
    "cm/s": Unit("velocity", 1e-2),
    "mm/s": Unit("velocity", 1e-3),
    "m/min": Unit("velocity", 1.0 / 60.0),
    "mm/min": Unit("velocity", 1e-3 / 60.0),
    "in/s": Unit("velocity", INCH),
    "N": Unit("force", 1.0),
    "mN": Unit("force", 1e-3),
    "daN": Unit("force", 10.0),
    "kN": Unit("force", 1e3),
    "MN": Unit("force", 1e6),
    "lbf": Unit("force", POUND_FORCE),
    "kgf": Unit("force", 9.80665),
    "Pa": Unit("pressure", 1.0),
    "hPa": Unit("pressure", 1e2),
    "kPa": Unit("pressure", 1e3),
    "MPa": Unit("pressure", 1e6),
    "bar": Unit("pressure", 1e5),
    "mbar": Unit("pressure", 1e2),
    "psi": Unit("pressure", POUND_FORCE / INCH**2),
    "N/mm²": Unit("pressure", 1e6),
    "kp": Unit("force", 9.80665),
    "l/min": Unit("flow", 1e-3 / 60.0),
    "m³/s": Unit("flow", 1.0),
    "cm³/s": Unit("flow", 1e-6),
    "m/s²": Unit("acceleration", 1.0),
    "K": Unit("temperature", 1.0),
    "°C": Unit("temperature", 1.0, 273.15),
    "degC": Unit("temperature", 1.0, 273.15),
    "C": Unit("temperature", 1.0, 273.15),
    "°F": Unit("temperature", 5.0 / 9.0, 273.15 - 32.0 * 5.0 / 9.0),
    "degF": Unit("temperature", 5.0 / 9.0, 273.15 - 32.0 * 5.0 / 9.0),
    "rad": Unit("angle", 1.0),
    "mrad": Unit("angle", 1e-3),
    "deg": Unit("angle", DEGREE),
    "°": Unit("angle", DEGREE),
    "rad/s": Unit("angular velocity", 1.0),
    "deg/s": Unit("angular velocity", DEGREE),
    "°/s": Unit("angular velocity", DEGREE),
    "rpm": Unit("angular velocity", 6.0 * DEGREE),
    "1/min": Unit("angular velocity", 6.0 * DEGREE),
    "Nm": Unit("torque", 1.0),
    "N·m": Unit("torque", 1.0),
    "N m": Unit("torque", 1.0),
    "kNm": Unit("torque", 1e3),
    "in·lbf": Unit("torque", POUND_FORCE * INCH),
    "in-lbf": Unit("torque", POUND_FORCE * INCH),
    "in lbf": Unit("torque", POUND_FORCE * INCH),
    "mNm": Unit("torque", 1e-3),
    "lbf·in": Unit("torque", POUND_FORCE * INCH),
    "A": Unit("current", 1.0),
    "mA": Unit("current", 1e-3),
    "V": Unit("voltage", 1.0),
    "mV": Unit("voltage", 1e-3),
    "%": Unit("ratio", 1e-2),
    "counts": Unit("counts", 1.0),
    "digits": Unit("counts", 1.0),
}
"""The units that are known, spelt with the case that tells mN from MN."""

ELECTRICAL = ("current", "voltage", "ratio", "counts")
"""Quantities that stand for another by a gain: a converter's, an amplifier's, a valve's."""

QUANTITIES: Mapping[str, str] = {
    "s": "time",
    "m": "length",
    "m/s": "velocity",
    "N": "force",
    "Pa": "pressure",
    "K": "temperature",
    "rad": "angle",
    "rad/s": "angular velocity",
    "N m": "torque",
}
"""Quantities by the SI unit of the data contract."""


def quantity_of(name: str) -> str:
    """Return the quantity that a name of the data contract stands for; the empty text where no unit list has it."""
    return "time" if name == "time_s" else QUANTITIES.get(READABLE[name].unit, "") if name in READABLE else ""


GAUGE = re.compile(r"(bar|psi)\s*(?:\(g\)|_?g|rel)\Z")
"""Pressure above the atmosphere's, whose difference to another one, and so all that is used of it, is the same."""

SPELLINGS: Mapping[str, str] = {
    **dict.fromkeys(("Bar", "BAR"), "bar"),
    **dict.fromkeys(("PSI", "Psi", "lbf/in²"), "psi"),
    **dict.fromkeys(("L/min", "lpm", "LPM", "l/Min"), "l/min"),
    **dict.fromkeys(("U/min", "1/Min", "min-1", "RPM", "rev/min"), "rpm"),
    **dict.fromkeys(("Sek", "sek", "Sec", "seconds"), "s"),
    **dict.fromkeys(("msec", "milliseconds"), "ms"),
    **dict.fromkeys(("Grad", "degrees"), "deg"),
    **dict.fromkeys(("Grad C", "deg C", "degrees C", "Celsius"), "°C"),
    **dict.fromkeys(("inch", '"'), "in"),
    **dict.fromkeys(("m3/s",), "m³/s"),
    **dict.fromkeys(("m/s2",), "m/s²"),
    **dict.fromkeys(("N/mm2",), "N/mm²"),
    **dict.fromkeys(("mm s-1", "mm·s-1"), "mm/s"),
    **dict.fromkeys(("m s-1", "m·s-1"), "m/s"),
    **dict.fromkeys(("count", "digit", "LSB"), "counts"),
    **dict.fromkeys(("percent", "Prozent"), "%"),
}
"""Other ways to write a known unit."""


def unit_of(text: str) -> str | None:
    """Return the known spelling of a unit as written in a header, such as ``[µm]`` in either code point; None if unknown."""
    text = text.strip().removeprefix("[").removesuffix("]")
    written = (
        " ".join(text.split()).replace("\N{GREEK SMALL LETTER MU}", "\N{MICRO SIGN}").replace("^-1", "-1").replace("^", "")
    )
    written = written.replace("*", "·").replace("\N{DOT OPERATOR}", "·").replace("º", "°")
    written = GAUGE.sub(r"\1", written)
    for candidate in (written, written.replace(" ", "")):
        known = SPELLINGS.get(candidate, candidate)
        if known in UNITS:
            return known
    return None
