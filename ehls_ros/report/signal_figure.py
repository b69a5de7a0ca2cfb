"""Figure of selected signals of a recording over time, with a row per unit."""

from collections.abc import Sequence

from ehls_ros.errors import BadInput
from ehls_ros.report.diagnosis_units import unit_for
from ehls_ros.report.page import Panel
from ehls_ros.report.plot import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, Axis, Trace, time_layout, time_line
from ehls_ros.report.run_signals import columns_of, largest_of, since_start
from ehls_ros.trajectory import MEASURED, READABLE, Trajectory

COLORS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
QUANTITIES = {"N": "force", "Pa": "pressure", "m": "displacement", "m/s": "velocity", "K": "temperature", "s": "time"}
"""Label of an axis of several signals, by its SI unit."""

MOST_ROWS = 8
"""Largest number of rows of a figure."""


def signals_over_time(run: Trajectory, names: Sequence[str]) -> Panel:
    """Draw signals over time, with one row per unit.

    Args:
        run: the recording.
        names: names of the signals; none: the measured ones.

    Raises:
        BadInput: a signal was not recorded, or there are none, or too many units.
    """
    chosen = list(names) or [name for name in MEASURED if name in run]
    if missing := [name for name in chosen if name not in run]:
        raise BadInput(f"there is no signal {missing[0]!r}", "plot", f"one of {', '.join(run.signals)}")
    by_unit: dict[str, list[str]] = {}
    for name in chosen:
        by_unit.setdefault(READABLE[name].unit, []).append(name)
    if not 1 <= len(by_unit) <= MOST_ROWS:
        raise BadInput(f"signals of {len(by_unit)} units are chosen", "plot", f"signals of 1 to {MOST_ROWS} units")
    time = since_start(run)
    traces: list[Trace] = []
    rows: list[Axis] = []
    for row, (symbol, members) in enumerate(by_unit.items(), start=1):
        unit = unit_for(symbol, max(largest_of(run[name]) for name in members))
        rows.append(Axis(QUANTITIES.get(symbol, ""), unit))
        lines = [(name, column) for name in members for column in columns_of(run[name])]
        for place, (name, values) in enumerate(lines):
            color = COLORS[(len(traces) if len(lines) == 1 else place) % len(COLORS)]
            traces.append(time_line(time, values, READABLE[name].label, unit, color, row=row))
    return Panel("Signals over time", traces, time_layout(float(time[-1]), rows), height=110 + 130 * len(rows))
