"""Statistics of a recording: length, rate, gaps, and each signal's range, mean and rms."""

from typing import NamedTuple

import numpy as np

from ehls_ros.report.page import MISSING_NUMBER, Row, number
from ehls_ros.report.quantities import percent, shown_signal
from ehls_ros.trajectory import Trajectory

GAP = 1.5
"""Interval between two samples that counts as a gap, in multiples of the usual one."""


class Sampling(NamedTuple):
    """Sampling of a recording.

    Attributes:
        seconds: from the first sample to the last [s].
        rate: usual sampling rate [Hz]; None with fewer than two samples.
        gaps: number of gaps between samples.
        longest: longest time between two samples [s].
    """

    seconds: float
    rate: float | None
    gaps: int
    longest: float


def sampling(run: Trajectory) -> Sampling:
    """Return the sampling of a recording."""
    steps = np.diff(run.time_s)
    if not steps.any():
        return Sampling(0.0, None, 0, 0.0)
    usual = float(np.median(steps))
    seconds = float(run.time_s[-1] - run.time_s[0])
    return Sampling(seconds, 1.0 / usual, int(np.sum(steps > GAP * usual)), float(np.max(steps)))


def sampling_sentence(run: Trajectory) -> str:
    """Return a sentence on the length, sampling rate and gaps of a recording."""
    found = sampling(run)
    if found.rate is None:
        return f"Samples: {len(run)}."
    text = f"{number(found.seconds, 4)} s at {number(found.rate, 4)} Hz, {number(len(run))} samples"
    if not found.gaps:
        return f"{text} without a gap."
    word = "gap" if found.gaps == 1 else "gaps"
    return f"{text} with {number(found.gaps)} {word} between them, the longest {number(found.longest)} s."


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
