"""Practical units, such as µm, bar or mm/s, chosen by the SI unit and the magnitude of the value."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.estimate import Estimate
from ehls_ros.report.identification_findings import as_shown, written
from ehls_ros.report.page import MISSING_NUMBER, number
from ehls_ros.report.plot import Unit
from ehls_ros.trajectory import READABLE

_LENGTH = ((1e-3, Unit("µm", 1e6)), (1.0, Unit("mm", 1e3)), (math.inf, Unit("m")))
_TIME = ((1.0, Unit("ms", 1e3)), (math.inf, Unit("s")))
_UNITS: Mapping[str, tuple[tuple[float, Unit], ...]] = {
    "m": _LENGTH,
    "m^2": ((math.inf, Unit("cm²", 1e4)),),
    "s": _TIME,
    "m/s": ((math.inf, Unit("mm/s", 1e3)),),
    "Pa": ((math.inf, Unit("bar", 1e-5)),),
    "Pa/s": ((math.inf, Unit("bar/s", 1e-5)),),
    "m^3/s": ((math.inf, Unit("cm³/s", 1e6)),),
    "m^5/(N s)": ((math.inf, Unit("cm³/(s bar)", 1e11)),),
    "m^3/(s Pa^0.5)": ((math.inf, Unit("cm³/(s √bar)", 1e6 * math.sqrt(1e5))),),
    "Pa s/m^3": ((math.inf, Unit("bar/(l/min)", 1e-5 / 6e4)),),
    "Pa s^2/m^6": ((math.inf, Unit("bar/(l/min)²", 1e-5 / 6e4**2)),),
    "N/m": ((1e3, Unit("N/m")), (math.inf, Unit("N/mm", 1e-3))),
    "N/m^2": ((1e6, Unit("N/m²")), (math.inf, Unit("N/mm²", 1e-6))),
    "N/m^3": ((1e9, Unit("N/m³")), (math.inf, Unit("N/mm³", 1e-9))),
    "N/m^5": ((1e15, Unit("N/m⁵")), (math.inf, Unit("N/mm⁵", 1e-15))),
    "N s/m": ((1e3, Unit("N s/m")), (math.inf, Unit("N s/mm", 1e-3))),
    "N s/(m K)": ((math.inf, Unit("N s/(mm K)", 1e-3)),),
    "1/Pa": ((math.inf, Unit("1/bar", 1e5)),),
    "N/Pa": ((math.inf, Unit("N/bar", 1e5)),),
}
ALMOST = 0.9995
"""Probability above which rounding to one decimal gives 100 %."""


def unit_for(unit: str, size: float) -> Unit:
    """Return the unit in which values of a magnitude are shown.

    Args:
        unit: SI unit, as parameters declare it.
        size: largest magnitude shown, in that unit.
    """
    key = unit.replace("³", "^3").replace("²", "^2")
    for most, shown in _UNITS.get(key, ()):
        if size < most:
            return shown
    return Unit("–" if unit == "1" else unit.replace("^2", "²").replace("^3", "³"))


def estimate(found: Estimate, digits: int = 2) -> str:
    """Write an estimate with its standard error."""
    unit = unit_for(found.unit, abs(found.value))
    text = written(unit.factor * found.value, unit.factor * found.std, digits)
    return f"{text.value} ± {text.error}{after(unit)}"


def value(size: float, unit: str, digits: int = 3) -> str:
    """Write a value in a practical unit."""
    shown = unit_for(unit, abs(size))
    return f"{as_shown(float(f'{shown.factor * size:.{digits}g}'))}{after(shown)}"


def change(size: float, unit: str) -> str:
    """Write a change, in per cent for a pure number."""
    return f"{number(100.0 * size, 2)} %" if unit == "1" else value(size, unit, 2)


def after(unit: Unit) -> str:
    """Return the text of a unit after a number."""
    return "" if unit.symbol == "–" else f" {unit.symbol}"


def percent(share: float | None) -> str:
    """Write a fraction in per cent, with one decimal close to 100 %."""
    if share is None or not math.isfinite(share):
        return MISSING_NUMBER
    if 0.0 < share < 1e-5:
        return "< 0.001 %"
    if share < 0.0:
        return f"−{number(-100.0 * share, 2)} %"
    return f"{number(100.0 * share, 2)} %" if share < 0.985 else f"{100.0 * share:.1f} %"


def likely(probability: float) -> str:
    """Write a probability in per cent, never as 100 %."""
    return "> 99.9 %" if probability >= ALMOST else percent(probability)


class Shown(NamedTuple):
    """A signal as shown along an axis.

    Attributes:
        quantity: name of the quantity.
        unit: unit of the values.
        values: in that unit, shape (n,).
    """

    quantity: str
    unit: Unit
    values: Array


_QUANTITIES: Mapping[str, tuple[str, str]] = {
    "time_s": ("time", "s"),
    "valve_command_m": ("valve command", "m"),
    "spool_m": ("spool", "m"),
    "load_pressure_pa": ("load pressure", "Pa"),
    "load_pressure_rate_pa_s": ("rate of load pressure", "Pa/s"),
    "supply_pressure_pa": ("supply pressure", "Pa"),
    "position_m": ("position", "m"),
    "velocity_m_s": ("velocity", "m/s"),
    "acceleration_m_s2": ("acceleration", "m/s²"),
    "force_n": ("driving force", "N"),
    "disturbance_force_n": ("disturbance force", "N"),
    "oil_temperature_k": ("oil temperature", "°C"),
}
_KELVIN = 273.15


def quantity(signal: str) -> str:
    """Return the name of a signal in a sentence."""
    return _QUANTITIES.get(signal, (signal.replace("_", " "), ""))[0]


def shown_signal(signal: str, values: Array, largest: float | None = None) -> Shown:
    """Return a signal in the practical unit of its axis.

    Args:
        signal: name in the data contract, or of a derived signal.
        values: in SI, shape (n,).
        largest: magnitude that selects the unit if several recordings share an axis; by default that of the values.
    """
    declared = READABLE[signal].unit if signal in READABLE else "1"
    name, unit = _QUANTITIES.get(signal, (signal.replace("_", " "), declared))
    if unit == "°C":
        return Shown(name, Unit("°C"), values - _KELVIN)
    finite = values[np.isfinite(values)]
    if largest is None:
        largest = float(np.max(np.abs(finite))) if finite.size else 0.0
    shown = Unit("s") if signal == "time_s" else unit_for(unit, largest)
    return Shown(name, shown, values * shown.factor)
