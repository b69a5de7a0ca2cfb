"""Units as written in headers of measured data and in data sheets, with their SI values.

The list is closed. A general units library reads ``Nm`` as a number times a metre, ``C`` as coulombs, ``bar(g)`` as bar times
grams and ``1/min`` as a frequency. It does not distinguish an angle from a ratio or a count.
"""

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from ehls_ros.errors import one_of
from ehls_ros.schema import Misfit


class Unit(NamedTuple):
    """A unit: the SI value is ``scale`` times the number plus ``offset``.

    Attributes:
        quantity: physical quantity.
        scale: SI units per unit.
        offset: SI value of zero.
    """

    quantity: str
    scale: float
    offset: float = 0.0


POUND_FORCE, INCH = 4.4482216152605, 0.0254
"""In newtons and metres, by definition."""

DEGREE = math.pi / 180.0

UNITS: Mapping[str, Unit] = {
    "s": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "µs": Unit("time", 1e-6),
    "ns": Unit("time", 1e-9),
    "min": Unit("time", 60.0),
    "h": Unit("time", 3600.0),
    "d": Unit("time", 86400.0),
    "m": Unit("length", 1.0),
    "dm": Unit("length", 0.1),
    "cm": Unit("length", 1e-2),
    "mm": Unit("length", 1e-3),
    "µm": Unit("length", 1e-6),
    "in": Unit("length", INCH),
    "m^2": Unit("area", 1.0),
    "cm^2": Unit("area", 1e-4),
    "mm^2": Unit("area", 1e-6),
    "m^3": Unit("volume", 1.0),
    "l": Unit("volume", 1e-3),
    "cm^3": Unit("volume", 1e-6),
    "m/s": Unit("velocity", 1.0),
    "cm/s": Unit("velocity", 1e-2),
    "mm/s": Unit("velocity", 1e-3),
    "m/min": Unit("velocity", 1.0 / 60.0),
    "mm/min": Unit("velocity", 1e-3 / 60.0),
    "in/s": Unit("velocity", INCH),
    "m/s^2": Unit("acceleration", 1.0),
    "gn": Unit("acceleration", 9.80665),
    "kg": Unit("mass", 1.0),
    "g": Unit("mass", 1e-3),
    "t": Unit("mass", 1e3),
    "kg/m^3": Unit("density", 1.0),
    "g/cm^3": Unit("density", 1e3),
    "N": Unit("force", 1.0),
    "mN": Unit("force", 1e-3),
    "daN": Unit("force", 10.0),
    "kN": Unit("force", 1e3),
    "MN": Unit("force", 1e6),
    "lbf": Unit("force", POUND_FORCE),
    "kip": Unit("force", 1e3 * POUND_FORCE),
    "kgf": Unit("force", 9.80665),
    "N/s": Unit("force rate", 1.0),
    "kN/s": Unit("force rate", 1e3),
    "Pa": Unit("pressure", 1.0),
    "hPa": Unit("pressure", 1e2),
    "kPa": Unit("pressure", 1e3),
    "MPa": Unit("pressure", 1e6),
    "bar": Unit("pressure", 1e5),
    "mbar": Unit("pressure", 1e2),
    "psi": Unit("pressure", POUND_FORCE / INCH**2),
    "ksi": Unit("pressure", 1e3 * POUND_FORCE / INCH**2),
    "N/mm^2": Unit("pressure", 1e6),
    "m^3/s": Unit("flow", 1.0),
    "l/min": Unit("flow", 1e-3 / 60.0),
    "gpm": Unit("flow", 231.0 * INCH**3 / 60.0),
    "cm^3/s": Unit("flow", 1e-6),
    "N/m": Unit("stiffness", 1.0),
    "kN/m": Unit("stiffness", 1e3),
    "N/mm": Unit("stiffness", 1e3),
    "N s/m": Unit("damping", 1.0),
    "N s/mm": Unit("damping", 1e3),
    "K": Unit("temperature", 1.0),
    "°C": Unit("temperature", 1.0, 273.15),
    "°F": Unit("temperature", 5.0 / 9.0, 273.15 - 32.0 * 5.0 / 9.0),
    "rad": Unit("angle", 1.0),
    "mrad": Unit("angle", 1e-3),
    "°": Unit("angle", DEGREE),
    "rad/s": Unit("angular velocity", 1.0),
    "°/s": Unit("angular velocity", DEGREE),
    "rpm": Unit("angular velocity", 6.0 * DEGREE),
    "Hz": Unit("angular velocity", 2.0 * math.pi),
    "kHz": Unit("angular velocity", 2e3 * math.pi),
    "N m": Unit("torque", 1.0),
    "mN m": Unit("torque", 1e-3),
    "kN m": Unit("torque", 1e3),
    "in lbf": Unit("torque", POUND_FORCE * INCH),
    "A": Unit("current", 1.0),
    "mA": Unit("current", 1e-3),
    "V": Unit("voltage", 1.0),
    "mV": Unit("voltage", 1e-3),
    "%": Unit("ratio", 1e-2),
    "mV/V": Unit("ratio", 1e-3),
    "mm/mm": Unit("ratio", 1.0),
    "µm/m": Unit("ratio", 1e-6),
    "counts": Unit("counts", 1.0),
}
"""Known units; case matters, as in mN and MN."""

QUANTITIES: Mapping[str, str] = {
    "s": "time",
    "m": "length",
    "m^2": "area",
    "m^3": "volume",
    "m/s": "velocity",
    "kg": "mass",
    "kg/m^3": "density",
    "N": "force",
    "N/s": "force rate",
    "Pa": "pressure",
    "m^3/s": "flow",
    "N/m": "stiffness",
    "N s/m": "damping",
    "K": "temperature",
    "rad": "angle",
    "rad/s": "angular velocity",
    "N m": "torque",
}
"""Quantities by the SI unit of rig files and of the data contract."""

SPELLINGS: Mapping[str, str] = {
    **dict.fromkeys(("Bar", "BAR"), "bar"),
    **dict.fromkeys(("PSI", "Psi", "lbf/in^2"), "psi"),
    **dict.fromkeys(("KSI", "Ksi", "kip/in^2"), "ksi"),
    "kp": "kgf",
    **dict.fromkeys(("kips", "kip-f", "kipf", "klbf"), "kip"),
    **dict.fromkeys(("lb", "lbs", "lbs-f", "lb-f"), "lbf"),
    **dict.fromkeys(("Newton", "Newtons", "newton", "newtons"), "N"),
    **dict.fromkeys(("Volt", "Volts", "volt", "volts"), "V"),
    **dict.fromkeys(("Amps", "Ampere", "amps"), "A"),
    **dict.fromkeys(("g_n", "g0", "gee", "gees"), "gn"),
    **dict.fromkeys(("GPM", "gal/min"), "gpm"),
    "m/m": "mm/mm",
    "in/in": "mm/mm",
    **dict.fromkeys(("µε", "microstrain", "ue"), "µm/m"),
    **dict.fromkeys(("L", "dm^3"), "l"),
    **dict.fromkeys(("L/min", "lpm", "LPM", "l/Min"), "l/min"),
    **dict.fromkeys(("1/min", "U/min", "1/Min", "min-1", "RPM", "rev/min"), "rpm"),
    **dict.fromkeys(("sec", "Sek", "sek", "Sec", "SEC", "second", "seconds", "Sekunde", "Sekunden"), "s"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("hr", "hrs", "hour", "hours", "Std"), "h"),
    **dict.fromkeys(("day", "days", "Tag", "Tage"), "d"),
    **dict.fromkeys(("msec", "milliseconds"), "ms"),
    "us": "µs",
    "um": "µm",
    **dict.fromkeys(("deg", "Grad", "degrees"), "°"),
    "deg/s": "°/s",
    **dict.fromkeys(("degC", "C", "Grad C", "deg C", "degrees C", "Celsius"), "°C"),
    "degF": "°F",
    **dict.fromkeys(("inch", "inches", '"'), "in"),
    **dict.fromkeys(("mm s-1", "mm·s-1"), "mm/s"),
    **dict.fromkeys(("m s-1", "m·s-1"), "m/s"),
    **dict.fromkeys(("Ns/m", "N·s/m"), "N s/m"),
    **dict.fromkeys(("Ns/mm", "N·s/mm"), "N s/mm"),
    **dict.fromkeys(("Nm", "N·m"), "N m"),
    **dict.fromkeys(("mNm", "mN·m"), "mN m"),
    **dict.fromkeys(("kNm", "kN·m"), "kN m"),
    **dict.fromkeys(("in·lbf", "in-lbf", "lbf·in"), "in lbf"),
    **dict.fromkeys(("count", "digit", "digits", "LSB"), "counts"),
    **dict.fromkeys(("percent", "Prozent"), "%"),
}
"""Alternative spellings of known units."""

GAUGE = re.compile(r"(bar|psi)\s*(?:\(g\)|_?g|rel)\Z")
"""Gauge pressure; only pressure differences are used, for which gauge and absolute pressure are equivalent."""

POWER = re.compile(r"(?<=[a-z])([23])\b")
"""An exponent without its sign, such as in ``mm2``."""

NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
"""A number, with or without a unit."""


def unit_of(text: str) -> str | None:
    """Return the standard spelling of a unit as users write it, such as ``[µm]`` or ``sec.``; None if unknown."""
    text = text.strip().removeprefix("[").removesuffix("]").removesuffix(".")
    written = " ".join(text.split()).replace("\N{GREEK SMALL LETTER MU}", "\N{MICRO SIGN}").replace("º", "°")
    written = written.replace("*", "·").replace("\N{DOT OPERATOR}", "·")
    written = written.replace("^-1", "-1").replace("²", "^2").replace("³", "^3")
    written = POWER.sub(r"^\1", GAUGE.sub(r"\1", written))
    for candidate in (written, written.replace(" ", "")):
        known = SPELLINGS.get(candidate, candidate)
        if known in UNITS:
            return known
    return None


def size(unit: str) -> float:
    """Return the size of a known unit in the SI unit of its quantity."""
    return UNITS[unit].scale


def in_unit(text: str, unit: str) -> float:
    """Parse a number with an optional unit.

    Args:
        text: such as ``210 bar``; a number alone is in the requested unit.
        unit: requested unit, such as ``MPa``.

    Returns:
        The number in the requested unit.

    Raises:
        Misfit: there is no number, or a unit of another quantity.
    """
    found = NUMBER.fullmatch(text)
    if found is None:
        raise Misfit(text, f"a number, in {unit} or with another unit after it")
    if found[2].startswith(","):
        raise Misfit(text, "a number with a decimal point and without separators of thousands")
    number, written, asked = float(found[1]), found[2], UNITS[unit]
    given = unit_of(written) if written else unit
    if given is None or UNITS[given].quantity != asked.quantity:
        known = [name for name, other in UNITS.items() if other.quantity == asked.quantity]
        raise Misfit(text, f"a number with {one_of(written, known)}")
    return number if given == unit else (size(given) * number + UNITS[given].offset - asked.offset) / asked.scale
