"""Figures of a verification: each function takes a block's result and returns a panel."""

import numpy as np

from ehls_ros.experiments.verification.response import Response
from ehls_ros.experiments.verification.results import Cyclic
from ehls_ros.report import plot
from ehls_ros.report.page import Panel, plane
from ehls_ros.report.plot import Axis, Trace, Unit, bars
from ehls_ros.report.run_signals import force_unit

PERCENT = Unit("%")
MAX_MARKS = 2000
"""Maximum number of cycles in a trend; longer ones are decimated."""


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
    stride = -(-len(trend.cycle) // MAX_MARKS)
    peak, valley = trend.peak_n - trend.reference_peak_n, trend.valley_n - trend.reference_valley_n
    unit = force_unit(peak, valley)
    traces: list[Trace] = []
    for name, values, color, symbol in (
        ("peak", peak, plot.VERMILION, "triangle-up"),
        ("valley", valley, plot.BLUE, "triangle-down"),
    ):
        for kept, label, mark in ((trend.judged, name, symbol), (~trend.judged, f"{name}, left out", f"{symbol}-open")):
            rows = np.flatnonzero(kept)[::stride]
            if rows.size:
                traces.append(plot.dots(trend.cycle[rows], values[rows], label, unit, color, symbol=mark, size=6))
    shown = "" if stride == 1 else f" One of {stride} cycles is shown."
    x, y = Axis("cycle", Unit("number")), Axis("measured less reference", unit)
    return plane("Peaks and valleys", traces, x, y, f"Of the fitted waveform of each complete cycle.{shown}", 320)


def harmonics(found: Cyclic) -> Panel:
    """Draw the higher harmonics of force and reference in percent of the fundamental, with expanded uncertainties."""
    rows = found.harmonics[1:]
    first = found.harmonics[0].measured_n or np.nan
    order = np.array([float(row.order) for row in rows])
    measured, asked = np.array([row.percent for row in rows]), np.array([row.reference_percent for row in rows])
    spread = np.array([100.0 * row.expanded_n / first for row in rows])
    whiskers = {"type": "data", "array": plot.packed(spread), "color": plot.BLACK, "thickness": 1.2, "width": 3}
    hover = "%{y:.3~g} %"
    traces = [
        bars(plot.packed(order), plot.packed(measured), "measured", plot.BLUE, hover, error_y=whiskers),
        bars(plot.packed(order), plot.packed(asked), "reference", plot.LIGHT_GREY, hover),
    ]
    note = "In percent of the fundamental; whiskers: expanded uncertainty, k = 2."
    panel = plane("Harmonics", traces, Axis("harmonic", Unit("order")), Axis("amplitude", PERCENT), note, 320, barmode="group")
    panel.layout["xaxis"] |= {"dtick": 1}
    return panel


def response(found: Response) -> Panel:
    """Draw gain, lag and coherence of the force over frequency."""
    x = Axis("frequency", Unit("Hz"))
    rows = (("gain", found.gain, Unit("–")), ("lag", found.lag_s, Unit("ms", 1e3)), ("coherence", found.coherence, Unit("–")))
    traces = [
        plot.line(found.frequency, values, name, unit, plot.BLUE, row=row)
        for row, (name, values, unit) in enumerate(rows, start=1)
    ]
    layout = plot.stacked_layout(x, [Axis(name, unit) for name, _, unit in rows])
    layout["xaxis"] |= {"type": "log"}
    return Panel("Response", traces, layout, "Force with respect to its reference, over frequency.", 420, over_time=False)
