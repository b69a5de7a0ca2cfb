"""Statistics of a recording: length, rate, gaps, and each signal's range, mean and rms."""

import numpy as np

from ehls_ros.report.page import MISSING_NUMBER, Row, number
from ehls_ros.report.quantities import percent, shown_signal
from ehls_ros.trajectory import Trajectory

GAP = 1.5
"""Interval between two samples that counts as a gap, in multiples of the usual one."""


def sampling_sentence(run: Trajectory) -> str:
    """Return a sentence on the length, sampling rate and gaps of a recording."""
    steps = np.diff(run.time_s)
    if not steps.any():
        return f"Samples: {len(run)}."
    usual, seconds = float(np.median(steps)), float(run.time_s[-1] - run.time_s[0])
    text = f"{number(seconds, 4)} s at {number(1.0 / usual, 4)} Hz, {number(len(run))} samples"
    gaps = int(np.sum(steps > GAP * usual))
    if not gaps:
        return f"{text} without a gap."
    longest = number(float(np.max(steps)))
    return f"{text} with {number(gaps)} {'gap' if gaps == 1 else 'gaps'} between them, the longest {longest} s."


def statistics(run: Trajectory) -> tuple[list[str], list[Row]]:
    """Return header and rows of a table of all signals, in practical units."""
    rows: list[Row] = []
    for name, values in run.signals.items():
        finite = values[np.isfinite(values)]
        if values.ndim > 1:
            continue
        missing = percent(1.0 - finite.size / values.size) if values.size else MISSING_NUMBER
        if not finite.size:
            rows.append([name, *[MISSING_NUMBER] * 4, "", missing])
            continue
        shown = shown_signal(name, finite)
        figures = (shown.values.min(), shown.values.max(), shown.values.mean(), np.sqrt(np.mean(shown.values**2)))
        rows.append([name, *(number(float(figure), 4) for figure in figures), shown.unit.symbol, missing])
    return ["signal", "minimum", "maximum", "mean", "rms", "unit", "missing"], rows
