"""Plots of the page: available signals, their units, and the initial plots."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from ehls_ros.trajectory import SIGNALS as DECLARED

ELEMENTS = 8
"""Friction elements that can be plotted; of a model with more, only the first ones."""

RESPONSE = "response_us"
"""Time from sending a snapshot to sending its valve command [us]; computed from the time stamps."""

FORCE_REFERENCE, POSITION_REFERENCE = "force_reference_n", "position_reference_m"
"""References of the two kinds, as published for each cycle: a law's status may lack some."""

PEAK, VALLEY = "peak_n", "valley_n"
"""Largest and smallest force of the last complete load cycle of a test programme."""

SPANS = (5.0, 10.0, 30.0, 60.0)
"""Selectable time spans [s]; the second is the default."""

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "N": {"N": 1.0, "kN": 1e-3},
        "Pa": {"MPa": 1e-6, "bar": 1e-5},
        "m": {"mm": 1e3, "m": 1.0},
        "m/s": {"mm/s": 1e3, "m/s": 1.0},
    }
)
"""Selectable units by SI unit, with the factor to each."""

MIRRORED = "force_bound_n"
"""Bound drawn on both sides of zero."""

_SHORT = {
    "force_n": "force",
    FORCE_REFERENCE: "reference",
    "force_error_n": "error",
    MIRRORED: "bound",
    "supply_pressure_pa": "supply",
    "load_pressure_pa": "load pressure",
    "pressure_a_pa": "A",
    "pressure_b_pa": "B",
    "valve_command_m": "command",
    "spool_m": "spool",
    "friction_gms_n": "all elements",
    "friction_viscous_n": "viscous",
    "position_reference_m": "reference",
    "position_m": "position",
    "velocity_m_s": "velocity",
    "alpha": "α̂",
    "beta": "β̂",
    "delta_n": "D̂",
    "e3_pa": "e3",
    "s_pa_s": "s",
    "oil_temperature_k": "oil",
}
"""Signals that can be plotted, and their short names in a legend."""

_BENEATH = {FORCE_REFERENCE, MIRRORED, "supply_pressure_pa", "valve_command_m", "friction_viscous_n", "position_reference_m"}
"""References and comparison signals: grey and wider, so that they show beneath the line that covers them."""


class Signal(NamedTuple):
    """A signal that can be plotted.

    Attributes:
        short: name in a legend.
        label: full name.
        unit: SI unit.
        beneath: whether it is drawn grey, beneath the others.
        mirrored: whether its negative is drawn too.
    """

    short: str
    label: str
    unit: str
    beneath: bool = False
    mirrored: bool = False


class Panel(NamedTuple):
    """One plot.

    Attributes:
        title: heading.
        unit: unit it is shown in unless another is chosen.
        signals: names in :data:`SIGNALS`.
        logarithmic: whether the vertical axis is logarithmic.
        wide: whether it takes two of the three columns of a wide screen, of which the plots fill four rows.
    """

    title: str
    unit: str
    signals: tuple[str, ...]
    logarithmic: bool = False
    wide: bool = False


_OF_PROGRAMME = {
    PEAK: Signal("peak", "peak of the last load cycle", "N"),
    VALLEY: Signal("valley", "valley of the last load cycle", "N"),
}


def _signals() -> dict[str, Signal]:
    known = {
        name: Signal(short, DECLARED[name].label, DECLARED[name].unit, name in _BENEATH, name == MIRRORED)
        for name, short in _SHORT.items()
    }
    elements = {element(i): Signal(f"{i + 1}", f"force of friction element {i + 1}", "N") for i in range(ELEMENTS)}
    return known | elements | {RESPONSE: Signal("response", "time from snapshot to command", "µs"), **_OF_PROGRAMME}


def element(number: int) -> str:
    """Return the name of a friction element's force."""
    return f"friction_elements_n[{number}]"


SIGNALS = MappingProxyType(_signals())
"""All signals of the page by name."""

PANELS = (
    Panel("Force", "kN", (FORCE_REFERENCE, "force_n"), wide=True),
    Panel("Force error", "N", (MIRRORED, "force_error_n")),
    Panel("Pressure", "MPa", ("supply_pressure_pa", "load_pressure_pa", "pressure_a_pa", "pressure_b_pa")),
    Panel("Spool", "mm", ("valve_command_m", "spool_m")),
    Panel("Friction elements", "N", ("friction_viscous_n", *(element(i) for i in range(ELEMENTS)))),
    Panel("Piston", "mm", ("position_reference_m", "position_m")),
    Panel("Friction scales", "1", ("alpha", "beta")),
    Panel("Remaining disturbance", "N", ("delta_n",)),
    Panel("Peaks and valleys", "kN", (PEAK, VALLEY), wide=True),
    Panel("Loop: snapshot to command", "µs", (RESPONSE,), logarithmic=True),
)


def options(panel: Panel) -> dict[str, Any]:
    """Return the ECharts options of an empty panel; the browser adds lines, colours and data."""
    return {
        "animation": False,
        "grid": {"left": 58, "right": 12, "top": 10, "bottom": 24},
        "tooltip": {"trigger": "axis", "confine": True, "transitionDuration": 0, "order": "seriesAsc"},
        "xAxis": {
            "type": "value",
            "max": 0.0,
            "splitNumber": 5,
            "axisLine": {"onZero": False},
            "axisLabel": {"formatter": "{value} s"},
        },
        "yAxis": {
            "type": "log" if panel.logarithmic else "value",
            "scale": True,
            "nameLocation": "middle",
            "nameGap": 42,
            "splitNumber": 4,
        },
    }
