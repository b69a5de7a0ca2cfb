"""Units of a rig's quantities: what data sheets use instead of SI units, and what is mistaken for them."""

import math
import re
from collections.abc import Mapping

from ehls_ros.errors import one_of
from ehls_ros.schema import Misfit

UNITS: Mapping[str, Mapping[str, float]] = {
    "Pa": {"bar": 1e5, "MPa": 1e6, "kPa": 1e3, "psi": 6894.757293168},
    "kg/m^3": {"g/cm^3": 1e3},
    "m": {"mm": 1e-3, "cm": 1e-2, "in": 0.0254},
    "m^2": {"cm^2": 1e-4, "mm^2": 1e-6},
    "m^3": {"l": 1e-3, "cm^3": 1e-6},
    "m^3/s": {"l/min": 1e-3 / 60.0},
    "kg": {"t": 1e3, "g": 1e-3},
    "N": {"kN": 1e3},
    "m/s": {"mm/s": 1e-3},
    "N/m": {"N/mm": 1e3, "kN/m": 1e3},
    "N s/m": {"N s/mm": 1e3},
    "rad/s": {"Hz": 2.0 * math.pi, "kHz": 2e3 * math.pi},
}
"""By SI unit: other units of the quantity and their size in it."""

WRITTEN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")
"""A number, with or without a unit."""


def si_unit(unit: str) -> str:
    """Return the SI unit of the quantity that a unit measures; the unit itself where no other is known."""
    return next((si for si, others in UNITS.items() if unit in others), unit)


def size(unit: str) -> float:
    """Return the size of a unit in the SI unit of its quantity; 1 for a unit that is not known."""
    return UNITS.get(si_unit(unit), {}).get(unit, 1.0)


def in_unit(text: str, unit: str) -> float:
    """Read a number that may have a unit.

    Args:
        text: such as ``210 bar``; a number alone is in the unit that is asked for.
        unit: the unit asked for, such as ``MPa``.

    Returns:
        The number in the unit asked for.

    Raises:
        Misfit: there is no number, or a unit of another quantity.
    """
    found = WRITTEN.fullmatch(text)
    if found is None:
        raise Misfit(text, f"a number, in {unit} or with another unit after it")
    if found[2].startswith(","):
        raise Misfit(text, "a number with a decimal point and without separators of thousands")
    number, given = float(found[1]), found[2].replace("²", "^2").replace("³", "^3")
    si = si_unit(unit)
    known = (si, *UNITS.get(si, {}))
    if given and given not in known:
        raise Misfit(text, f"a number with {one_of(given, known)}")
    return number * size(given) / size(unit) if given and given != unit else number
