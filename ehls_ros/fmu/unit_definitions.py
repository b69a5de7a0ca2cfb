"""Units of declarations, such as ``m^5/(N s)``, as exponents of the SI base units; units of the sensed signals."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from ehls_ros.physics.rig import EVERY_SENSED

SIGNAL_UNITS: Mapping[str, str] = dict(zip(EVERY_SENSED, ("m", "m/s", "Pa", "m", "N", "Pa", "K", "Pa", "Pa"), strict=True))
"""Units of the sensed signals, by name."""

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units of FMI."""


class BaseUnit(NamedTuple):
    """A unit as a factor and exponents of :data:`BASE`, in their order."""

    factor: float
    exponents: tuple[int, ...]


def _unit(factor: float = 1.0, **exponents: int) -> BaseUnit:
    return BaseUnit(factor, tuple(exponents.get(name, 0) for name in BASE))


SYMBOLS: Mapping[str, BaseUnit] = {
    "1": _unit(),
    "m": _unit(m=1),
    "mm": _unit(1e-3, m=1),
    "s": _unit(s=1),
    "kg": _unit(kg=1),
    "t": _unit(1e3, kg=1),
    "K": _unit(K=1),
    "rad": _unit(rad=1),
    "Hz": _unit(s=-1),
    "N": _unit(kg=1, m=1, s=-2),
    "Pa": _unit(kg=1, m=-1, s=-2),
    "MPa": _unit(1e6, kg=1, m=-1, s=-2),
}
"""Symbols that units are made of."""

_FRACTION = re.compile(r"\^\d+[/.]\d")

_TOKEN = re.compile(r"\s*(?:(?P<symbol>[A-Za-z]+|1)(?:\^(?P<power>-?\d+))?|(?P<mark>[/()]))")


def base_unit(unit: str) -> BaseUnit | None:
    """Return a unit in base units; None if an exponent is no whole number, which FMI cannot express.

    Args:
        unit: symbols with whole exponents; ``/`` divides by the next symbol or bracket.

    Raises:
        ValueError: the text is no such unit.
    """
    if _FRACTION.search(unit):
        return None
    product, place, sign, inside = _unit(), 0, 1, False
    while place < len(unit):
        match = _TOKEN.match(unit, place)
        if match is None or (match["symbol"] and match["symbol"] not in SYMBOLS):
            raise ValueError(f"unit {unit!r}")
        place = match.end()
        if match["symbol"]:
            power = sign * int(match["power"] or 1)
            symbol = SYMBOLS[match["symbol"]]
            exponents = tuple(a + power * b for a, b in zip(product.exponents, symbol.exponents, strict=True))
            product = BaseUnit(product.factor * symbol.factor**power, exponents)
            sign = sign if inside else 1
        elif match["mark"] == "/":
            sign = -1
        else:
            inside = match["mark"] == "("
            sign = sign if inside else 1
    return product
