"""Figures of a verification: each function takes a block's result and returns a panel."""

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.experiments.verification.results import Cyclic
from ehls_ros.report import plot
from ehls_ros.report.page import Panel
from ehls_ros.report.plot import Axis, Trace, Unit

PERCENT = Unit("%")
MOST_MARKS = 2000
"""Maximum number of cycles in a trend; longer ones are decimated."""


def force_unit(*values: Array) -> Unit:
    """Return the unit in which forces are shown."""
    largest = max((float(np.nanmax(np.abs(v))) for v in values if np.isfinite(v).any()), default=0.0)
    return plot.KILONEWTON if largest >= 1.0 / plot.KILONEWTON.factor else plot.NEWTON


def one_cycle(found: Cyclic) -> Panel:
    """Draw force and reference of the last judged cycle, and their difference below."""
    last = found.last
    error = last.force_n - last.reference_n
    force, difference = force_unit(last.force_n, last.reference_n), force_unit(error)
    time = 1e3 * last.time_s
    traces: list[Trace] = [
        plot.line(time, last.reference_n, "reference", force, plot.BLACK, width=1.2, dash="dash"),
        plot.line(time, last.force_n, "measured", force, plot.BLUE),
        plot.line(time, error, "measured less reference", difference, plot.VERMILION, row=2),
    ]
    layout = plot.stacked_layout(
        Axis("time in the cycle", Unit("ms")), [Axis("force", force, share=1.6), Axis("error", difference)]
    )
    return Panel("One cycle", traces, layout, "The last cycle that was judged, sample by sample.", 380, over_time=False)


def trend(found: Cyclic) -> Panel:
    """Draw the deviations of every cycle's peak and valley from the reference's."""
    trend = found.trend
    stride = -(-len(trend.cycle) // MOST_MARKS)
    peak, valley = trend.peak_n - trend.reference_peak_n, trend.valley_n - trend.reference_valley_n
    unit = force_unit(peak, valley)
    traces: list[Trace] = []
    for name, values, color, symbol in (
        ("peak", peak, plot.VERMILION, "triangle-up"),
        ("valley", valley, plot.BLUE, "triangle-down"),
    ):
        for kept, what, mark in ((trend.judged, name, symbol), (~trend.judged, f"{name}, left out", f"{symbol}-open")):
            rows = np.flatnonzero(kept)[::stride]
            if rows.size:
                traces.append(plot.dots(trend.cycle[rows], values[rows], what, unit, color, symbol=mark, size=6))
    layout = plot.plane_layout(Axis("cycle", Unit("number")), Axis("measured less reference", unit))
    shown = "" if stride == 1 else f" One of {stride} cycles is shown."
    return Panel(
        "Peaks and valleys", traces, layout, f"Of the fitted waveform of each complete cycle.{shown}", 320, over_time=False
    )


def harmonics(found: Cyclic) -> Panel:
    """Draw the higher harmonics of force and reference in percent of the fundamental, with expanded uncertainties."""
    rows = found.harmonics[1:]
    first = found.harmonics[0].measured_n or np.nan
    order = np.array([float(row.order) for row in rows])
    measured, asked = np.array([row.percent for row in rows]), np.array([row.reference_percent for row in rows])
    spread = np.array([100.0 * row.expanded_n / first for row in rows])
    bars: list[Trace] = [
        {
            "type": "bar",
            "x": plot.packed(order),
            "y": plot.packed(values),
            "name": name,
            "marker": {"color": color},
            "hovertemplate": "%{y:.3~g} %",
        }
        for name, values, color in (("measured", measured, plot.BLUE), ("reference", asked, plot.LIGHT_GREY))
    ]
    bars[0]["error_y"] = {"type": "data", "array": plot.packed(spread), "color": plot.BLACK, "thickness": 1.2, "width": 3}
    layout = plot.plane_layout(Axis("harmonic", Unit("order")), Axis("amplitude", PERCENT)) | {"barmode": "group"}
    layout["xaxis"] |= {"dtick": 1}
    note = "In percent of the fundamental; whiskers: expanded uncertainty, k = 2."
    return Panel("Harmonics", bars, layout, note, 320, over_time=False)
