"""Figures of one run over time: each function takes a trajectory and returns a figure, or the reason for its omission.

Quantities of the sliding mode law keep the paper's units (MPa, s).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.report import plot
from ehls_ros.report.decimation import part_means
from ehls_ros.report.page import LeftOut, Panel, Rows, number
from ehls_ros.report.plot import MEGAPASCAL, MICROSECOND, MILLIMETRE, NEWTON, PURE_NUMBER, Axis, Trace, Unit
from ehls_ros.report.quantities import unit_for
from ehls_ros.report.run_signals import (
    WITHOUT_VISCOUS,
    columns_of,
    error_of,
    force_unit,
    known,
    largest_of,
    missing_reason,
    missing_together,
    none_known,
    response_of,
    setting,
    several_elements,
    since_start,
    sliding_bound,
)
from ehls_ros.trajectory import MEASURED, OF_CHAMBERS, READABLE, Trajectory

RASTER_COLUMNS = 1500

COLORS = (plot.BLUE, plot.VERMILION, plot.GREEN, plot.PURPLE, plot.ORANGE, plot.SKY)
QUANTITIES = {"N": "force", "Pa": "pressure", "m": "displacement", "m/s": "velocity", "K": "temperature", "s": "time"}
"""Label of an axis of several signals, by its SI unit."""

MAX_ROWS = 8
"""Largest number of rows of a figure of chosen signals."""


class _Figure(Rows):
    """A figure of a run over time; signals without values are not drawn."""

    def __init__(self, run: Trajectory, title: str, *rows: Axis) -> None:
        """Begin a figure of a run."""
        super().__init__(title, since_start(run), *rows)
        self.run = run

    def signal(self, name: str, label: str, color: str, *, width: float = 1.5, dash: str = "solid") -> None:
        """Draw a signal if it is known."""
        if known(self.run, name):
            self.line(self.run[name], label, color, width=width, dash=dash)

    def reference(self, name: str, label: str) -> None:
        """Draw a reference if it is known."""
        self.signal(name, label, plot.BLACK, width=1.2, dash="dash")

    def marks(self, name: str, label: str) -> None:
        """Mark the times at which a flag is set."""
        if known(self.run, name):
            self.traces += plot.event_marks(self.time, self.run[name] > 0.5, label, plot.VERMILION)

    def limit(self, limit: NDArray[np.float64], largest: float, name: str, unit: Unit) -> str:
        """Draw plus and minus a limit; if it is so far away that the signal would be a flat line, return a note instead."""
        if not np.isfinite(limit).any():
            return ""
        if largest_of(limit) > 2.5 * largest:
            shown = number(largest_of(limit) * unit.factor)
            return f"The {name}, ±{shown} {unit.symbol}, is outside the figure."
        self.traces += plot.limits(self.time, limit, f"± {name}", unit)
        return ""


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
    if not 1 <= len(by_unit) <= MAX_ROWS:
        raise BadInput(f"signals of {len(by_unit)} units are chosen", "plot", f"signals of 1 to {MAX_ROWS} units")
    figure = _Figure(run, "Signals over time")
    for symbol, members in by_unit.items():
        figure.row(Axis(QUANTITIES.get(symbol, ""), unit_for(symbol, max(largest_of(run[name]) for name in members))))
        lines = [(name, column) for name in members for column in columns_of(run[name])]
        for place, (name, values) in enumerate(lines):
            color = COLORS[(len(figure.traces) if len(lines) == 1 else place) % len(COLORS)]
            figure.line(values, READABLE[name].label, color)
    return figure.panel(height=110 + 130 * len(by_unit))


def force_tracking(run: Trajectory) -> Panel | LeftOut:
    """Draw force and reference, and the disturbance behind them."""
    if missing := missing_reason(run, "force_n"):
        return LeftOut("Force", missing)
    figure = _Figure(run, "Force", Axis("force", force_unit(run["force_n"])))
    figure.signal("disturbance_force_n", "disturbance", plot.ORANGE, width=1.2)
    figure.signal("force_n", "force", plot.BLUE, width=2.2)
    figure.reference("force_reference_n", "reference")
    return figure.panel(height=290)


def force_error(run: Trajectory, convergence_s: float | None) -> Panel | LeftOut:
    """Draw the force error inside its bound, scaled to the steady part of the run.

    Args:
        run: the trajectory.
        convergence_s: time since the start at which the error had converged [s]; None if it did not.
    """
    error = error_of(run)
    if error is None:
        return LeftOut("Force error", missing_together(run, slice(None), "force_reference_n", "force_n"))
    bounded = known(run, "force_bound_n")
    span, note = steady_span(error, largest_of(run["force_bound_n"]) if bounded else 0.0, NEWTON.symbol)
    figure = _Figure(run, "Force error", Axis("error", NEWTON, span))
    if bounded:
        figure.traces += plot.band(figure.time, run["force_bound_n"], "bound (44)", NEWTON)
    figure.line(error, "force − reference", plot.BLUE)
    if convergence_s:
        figure.traces.append(plot.time_mark(convergence_s, f"converged after {number(convergence_s)} s"))
    return figure.panel(note, 280)


def valve(run: Trajectory) -> Panel | LeftOut:
    """Draw spool command and spool between the limits of the rig."""
    signals = ("valve_command_m", "spool_m")
    if missing := none_known(run, *signals):
        return LeftOut("Valve", missing)
    figure = _Figure(run, "Valve", Axis("spool displacement", MILLIMETRE))
    figure.signal("valve_command_m", "command", plot.SKY)
    figure.signal("spool_m", "spool", plot.BLUE)
    limit = np.full(figure.time.shape, setting(run.metadata, "rig", "limits", "spool") or np.nan)
    largest = max(largest_of(run[name]) for name in signals if known(run, name))
    note = figure.limit(limit, largest, "limit of the spool", MILLIMETRE)
    figure.marks("saturated", "command cut at its limit")
    return figure.panel(note)


def load_pressure(run: Trajectory) -> Panel | LeftOut:
    """Draw the load pressure between plus and minus the supply pressure, and the pressures of both chambers if measured."""
    if missing := missing_reason(run, "load_pressure_pa"):
        return LeftOut("Load pressure", missing)
    figure = _Figure(run, "Load pressure", Axis("pressure", MEGAPASCAL))
    figure.signal("load_pressure_pa", "load pressure", plot.BLUE)
    for signal, chamber, color in zip(OF_CHAMBERS, "AB", (plot.GREEN, plot.ORANGE), strict=True):
        figure.signal(signal, f"pressure in {chamber}", color)
    if known(run, "supply_pressure_pa"):
        supply, name = run["supply_pressure_pa"], "supply pressure"
    else:
        nominal = setting(run.metadata, "rig", "plant", "supply_pressure")
        supply, name = np.full(figure.time.shape, nominal or np.nan), "nominal supply pressure"
    return figure.panel(figure.limit(supply, largest_of(run["load_pressure_pa"]), name, MEGAPASCAL))


def motion(run: Trajectory) -> Panel | LeftOut:
    """Draw position and velocity of the piston with their references, and the displacement of the position servo."""
    if missing := none_known(run, "position_m", "velocity_m_s"):
        return LeftOut("Motion", missing)
    figure, rows = _Figure(run, "Motion"), 0
    if known(run, "position_m"):
        rows = figure.row(Axis("position", MILLIMETRE))
        figure.signal("position_m", "piston position", plot.BLUE)
        if largest_of(run.signals.get("disturbance_displacement_m", np.zeros(1))) > 0:
            figure.signal("disturbance_displacement_m", "position servo", plot.ORANGE, width=1.2)
        figure.reference("position_reference_m", "position reference")
    if known(run, "velocity_m_s"):
        rows = figure.row(Axis("velocity", plot.MILLIMETRE_PER_SECOND))
        figure.signal("velocity_m_s", "piston velocity", plot.GREEN)
        figure.reference("position_reference_rate_m_s", "velocity reference")
    return figure.panel(height=160 + 90 * rows)


def position_error(run: Trajectory) -> Panel | LeftOut:
    """Draw the position error, scaled to the steady part of the run."""
    if missing := missing_together(run, slice(None), "position_reference_m", "position_m"):
        return LeftOut("Position error", missing)
    with np.errstate(invalid="ignore"):
        error = run["position_m"] - run["position_reference_m"]
    span, note = steady_span(error * MILLIMETRE.factor, 0.0, MILLIMETRE.symbol)
    figure = _Figure(run, "Position error", Axis("error", MILLIMETRE, span))
    figure.line(error, "position − reference", plot.BLUE)
    return figure.panel(note, 280)


def friction(run: Trajectory) -> Panel | LeftOut:
    """Draw the estimated friction, with several elements also the force and slip state of each."""
    if missing := none_known(run, "friction_gms_n", "friction_viscous_n", "friction_elements_n"):
        return LeftOut("Estimated friction", missing)
    figure, note, rows = _Figure(run, "Estimated friction"), "", 0
    several = several_elements(run)
    if known(run, "friction_gms_n") or known(run, "friction_viscous_n"):
        rows = figure.row(Axis("friction", NEWTON, share=2.0))
        figure.signal("friction_viscous_n", "viscous", plot.PURPLE)
        figure.signal("friction_gms_n", "all elements" if several else WITHOUT_VISCOUS, plot.BLACK, width=1.8)
    if several and known(run, "friction_elements_n"):
        rows = figure.row(Axis("each element", NEWTON, share=2.0))
        for index, force in enumerate(columns_of(run["friction_elements_n"])):
            color, dash = plot.ELEMENT_LINES[index % len(plot.ELEMENT_LINES)]
            figure.line(force, f"element {index + 1}", color, dash=dash)
    figure.marks("friction_fallback", "steady friction in use")
    if several and known(run, "friction_slipping"):
        slipping = run["friction_slipping"].reshape(len(run), -1)
        names = tuple(str(index + 1) for index in range(slipping.shape[1]))
        rows = figure.row(Axis("element", PURE_NUMBER, (len(names) + 0.5, 0.5), share=1.3, names=names))
        figure.traces += _raster(figure.time, slipping, rows)
        note = _slip_together(slipping)
    return figure.panel(note, 150 + 100 * rows)


def adaptation(run: Trajectory) -> Panel | LeftOut:
    """Draw the adapted quantities: the scales of friction and the remaining disturbance."""
    if missing := none_known(run, "alpha", "beta", "delta_n"):
        return LeftOut("Adaptation", missing)
    figure, rows = _Figure(run, "Adaptation"), 0
    if known(run, "alpha") or known(run, "beta"):
        rows = figure.row(Axis("scale", PURE_NUMBER))
        figure.signal("alpha", "α̂, friction elements", plot.BLUE)
        figure.signal("beta", "β̂, viscous friction", plot.VERMILION)
    if known(run, "delta_n"):
        rows = figure.row(Axis("D̂", plot.KILONEWTON))
        figure.signal("delta_n", "D̂, remaining disturbance", plot.GREEN)
    figure.marks("at_bound", "estimate at its bound")
    return figure.panel(height=160 + 80 * rows)


def sliding_variable(run: Trajectory) -> Panel | LeftOut:
    """Draw the sliding variable inside its bound b/h, scaled to the steady part of the run."""
    if missing := missing_reason(run, "s_pa_s"):
        return LeftOut("Sliding variable", missing)
    unit, bound = plot.MEGAPASCAL_PER_SECOND, sliding_bound(run.metadata)
    span, note = steady_span(run["s_pa_s"] * unit.factor, (bound or 0.0) * unit.factor, unit.symbol)
    figure = _Figure(run, "Sliding variable", Axis("s", unit, span))
    if bound is not None:
        label = f"bound ±b/h = ±{number(bound * unit.factor)} {unit.symbol}"
        figure.traces += plot.band(figure.time, np.full(figure.time.shape, bound), label, unit)
    figure.signal("s_pa_s", "s", plot.BLUE)
    return figure.panel(note)


def response_time(run: Trajectory) -> Panel | LeftOut:
    """Draw the time from snapshot to command over the run, with the missed cycles."""
    response = response_of(run)
    if response is None:
        return LeftOut("Response of the loop", missing_reason(run, "response_s") or "response_s holds no time above zero")
    period = [float(np.median(np.diff(run.time_s)))] if len(run) > 1 else []
    all_times = [float(np.nanmin(response)), float(np.nanmax(response)), *period]
    shown = 0.9 * min(all_times) * MICROSECOND.factor, 1.4 * max(all_times) * MICROSECOND.factor
    figure = _Figure(run, "Response of the loop", Axis("response", MICROSECOND, shown, logarithmic=True))
    figure.line(response, "snapshot to command", plot.BLUE, width=1.0)
    for seconds in period:
        label = f"period {number(seconds * MICROSECOND.factor)} {MICROSECOND.symbol}"
        figure.line(np.full(figure.time.shape, seconds), label, plot.GREY, dash="dash")
    if "valve_command_m" in run:
        missed = ~np.isfinite(run["valve_command_m"])
        figure.traces += plot.event_marks(figure.time, missed, "missed cycles", plot.VERMILION)
    note = {
        "lockstep": "The plant waited for every answer: a late one costs time, not accuracy.",
        "realtime": "The plant did not wait: after one period it held the last command.",
    }.get(str(run.metadata.get("timing")), "")
    return figure.panel(note)


def steady_span(values: NDArray[np.float64], bound: float, unit: str) -> tuple[tuple[float, float] | None, str]:
    """Scale an axis to the last half of a run, unless its start is hardly larger.

    Args:
        values: the signal as shown, shape (n,).
        bound: magnitude that must lie within the axis.
        unit: symbol of the unit shown.

    Returns:
        Limits of the axis, None to fit the data, and a note on the scaling.
    """
    largest = largest_of(values)
    steady = 1.25 * max(largest_of(values[len(values) // 2 :]), bound)
    if largest <= 1.5 * steady or steady == 0:
        return None, ""
    return (-steady, steady), f"Scaled to the steady part; the largest value of the run is {number(largest)} {unit}."


def _raster(time: NDArray[np.float64], slipping: NDArray[np.float64], row: int) -> list[Trace]:
    parts = min(RASTER_COLUMNS, len(time))
    cells = np.stack([part_means(values, parts) for values in columns_of(slipping)])
    colors = {"sticks": plot.LIGHT_GREY, "slips": plot.SKY}
    raster: Trace = {
        "type": "heatmap",
        "x": plot.packed(part_means(time, parts)),
        "y": list(range(1, len(cells) + 1)),
        "z": plot.packed(cells),
        "yaxis": f"y{row}",
        "zmin": 0,
        "zmax": 1,
        "colorscale": list(enumerate(colors.values())),
        "showscale": False,
        "ygap": 2,
        "hoverinfo": "skip",
    }
    mark = {"symbol": "square", "size": 11}
    keys = [plot.scatter("markers", [None], [None], name, marker=mark | {"color": color}) for name, color in colors.items()]
    return [raster, *keys]


def _slip_together(slipping: NDArray[np.float64]) -> str:
    known = slipping[np.isfinite(slipping).all(axis=1)] > 0.5
    if known.shape[1] < 2 or not known.any():
        return ""
    together = float(np.mean(known.all(axis=1) == known.any(axis=1)))
    remark = "All elements stick or slip together in "
    return f"{remark}{number(100 * together)} % of the cycles{', as one element would' if together > 0.95 else ''}."
