"""Numbers and estimates as text, in practical units such as µm, bar or mm/s.

The unit is chosen by the SI unit and the magnitude of the value; an estimate is rounded to its standard error.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.estimate import Estimate
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
NORMAL_95 = 1.96
"""Half of the 95 % interval of a normal distribution, in standard errors."""

EXACT = 1e-12
"""Standard error, as a fraction of the value, below which it counts as zero."""

ALMOST = 0.9995
"""Probability above which rounding to one decimal gives 100 %."""


class Written(NamedTuple):
    """An estimate as text.

    Attributes:
        value: rounded to the last significant digit of the standard error.
        error: the standard error, with as many decimals.
        low: lower end of the 95 % interval.
        high: upper end.
    """

    value: str
    error: str
    low: str
    high: str

    @property
    def interval(self) -> str:
        """The 95 % interval."""
        return MISSING_NUMBER if self.low == MISSING_NUMBER else f"{self.low} to {self.high}"


def written(value: float, std: float, digits: int = 2) -> Written:
    """Write a value and its standard error with the same number of decimals.

    Args:
        value: the value.
        std: its standard error; numbers that are not finite are written as a dash.
        digits: significant digits of the standard error.
    """
    if not math.isfinite(value):
        return Written(*[MISSING_NUMBER] * 4)
    if not math.isfinite(std):
        return Written(as_given(value), *[MISSING_NUMBER] * 3)
    if std <= EXACT * abs(value):
        text = as_given(value)
        return Written(text, number(std, digits), text, text)
    exponent = int(f"{std:.{digits - 1}e}".split("e")[1])
    decimals = max(0, digits - 1 - exponent)
    low, high = value - NORMAL_95 * std, value + NORMAL_95 * std
    return Written(*(fixed_point(x, decimals) for x in (value, std, low, high)))


def fixed_point(value: float, decimals: int) -> str:
    """Write a number with a fixed number of decimals."""
    return f"{value:,.{decimals}f}".replace(",", "\u202f").replace("-", "−")


def as_given(value: float) -> str:
    """Write a given, not measured, number with exactly its digits."""
    if not math.isfinite(value):
        return MISSING_NUMBER
    text = f"{value:,.10g}" if value == 0 or 1e-6 <= abs(value) < 1e10 else f"{value:.6g}"
    if "e-" in text and abs(value) >= 1e-6:
        text = f"{value:.12f}".rstrip("0")
    return text.replace(",", "\u202f").replace("-", "−")


def as_shown(value: float) -> str:
    """Write a number of a rig file, fitted or given, with six digits at most."""
    return as_given(float(f"{value:.6g}"))


def unit_text(unit: str) -> str:
    """Write a unit with raised powers."""
    return unit.replace("^2", "²").replace("^3", "³").replace("^5", "⁵")


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
    values: NDArray[np.float64]


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


def shown_signal(signal: str, values: NDArray[np.float64], largest: float | None = None) -> Shown:
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
