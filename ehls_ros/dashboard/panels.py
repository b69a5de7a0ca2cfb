"""What the page plots: the signals of each panel and their units."""

from typing import Any, NamedTuple

ELEMENTS = 4
"""Friction elements plotted; of a model with more, only the first ones."""

RESPONSE = "response_us"
"""Time from sending a snapshot to sending its valve command [us]; computed from the time stamps."""

FORCE_REFERENCE = "force_reference_n"
"""Force minus the controller's reported error, which saves subscribing to the reference."""

SPAN = 10.0
"""Time shown [s]."""


class Line(NamedTuple):
    """One line.

    Attributes:
        signal: name in the window.
        label: in the legend.
        colour: number in the stylesheet; 0 is grey, for references.
        factor: conversion from the signal's unit to the panel's.
        mirrored: whether the negative signal is drawn too, as for a bound.
    """

    signal: str
    label: str
    colour: int = 1
    factor: float = 1.0
    mirrored: bool = False


class Panel(NamedTuple):
    """One plot.

    Attributes:
        title: heading.
        unit: unit of the vertical axis.
        lines: in drawing order.
        logarithmic: whether the vertical axis is logarithmic.
    """

    title: str
    unit: str
    lines: tuple[Line, ...]
    logarithmic: bool = False


PANELS = (
    Panel("Force", "kN", (Line(FORCE_REFERENCE, "reference", 0, 1e-3), Line("force_n", "force", 1, 1e-3))),
    Panel("Force error", "N", (Line("force_bound_n", "bound", 0, mirrored=True), Line("force_error_n", "error"))),
    Panel(
        "Pressure",
        "MPa",
        (Line("supply_pressure_pa", "supply", 0, 1e-6), Line("load_pressure_pa", "load pressure", 1, 1e-6)),
    ),
    Panel("Spool", "mm", (Line("valve_command_m", "command", 0, 1e3), Line("spool_m", "spool", 1, 1e3))),
    Panel(
        "Friction elements",
        "N",
        (
            Line("friction_viscous_n", "viscous", 0),
            *(Line(f"friction_elements_n[{i}]", f"{i + 1}", i + 1) for i in range(ELEMENTS)),
        ),
    ),
    Panel("Piston", "mm", (Line("position_reference_m", "reference", 0, 1e3), Line("position_m", "position", 1, 1e3))),
    Panel("Friction scales", "ratio", (Line("alpha", "α̂"), Line("beta", "β̂", 2))),
    Panel("Remaining disturbance", "N", (Line("delta_n", "D̂"),)),
    Panel("Loop: snapshot to command", "µs", (Line(RESPONSE, "response"),), logarithmic=True),
)

SIGNALS = tuple(line.signal for panel in PANELS for line in panel.lines)


def options(panel: Panel) -> dict[str, Any]:
    """Return the ECharts options of an empty panel; the browser adds colours and data."""
    lines = [(line.label, line.colour) for line in panel.lines]
    lines += [(f"-{line.label}", line.colour) for line in panel.lines if line.mirrored]
    return {
        "animation": False,
        "grid": {"left": 58, "right": 12, "top": 10, "bottom": 24},
        "tooltip": {"trigger": "axis", "confine": True, "transitionDuration": 0, "order": "seriesAsc"},
        "xAxis": {
            "type": "value",
            "min": -SPAN,
            "max": 0.0,
            "interval": 2.0,
            "axisLine": {"onZero": False},
            "axisLabel": {"formatter": "{value} s"},
        },
        "yAxis": {
            "type": "log" if panel.logarithmic else "value",
            "scale": True,
            "name": panel.unit,
            "nameLocation": "middle",
            "nameGap": 42,
            "splitNumber": 4,
        },
        "series": [
            # References are wider, so that they show beneath the line that covers them.
            {"type": "line", "name": label, "showSymbol": False, "lineStyle": {"width": 1 if colour else 3}}
            for label, colour in lines
        ],
    }
