"""Times of day and dates as seconds."""

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

DAY = 86400.0
"""Length of a day [s]."""


def seconds_of_clock(cells: NDArray[Any]) -> NDArray[np.float64]:
    """Return the seconds since midnight of the first day in a column of clock times.

    Args:
        cells: texts such as ``12:03:04,125``, ``2026-05-01T12:03:04.125`` or ``1.5.2026 12:03:04``, shape (n,).

    Returns:
        Their times, shape (n,) [s]; NaN for invalid cells. A time of day that falls by over half a day belongs to the next day.
    """
    pandas: Any = import_module("pandas")
    text = pandas.Series(cells, dtype=str).str.replace(",", ".", regex=False).str.removesuffix("Z")
    first = next((cell for cell in text if isinstance(cell, str)), "")
    if "-" in first:
        return seconds_of_moments(pandas.to_datetime(text, format="ISO8601", errors="coerce").to_numpy())
    if first.count(".") < 2:
        seconds = seconds_of_moments(pandas.to_timedelta(text, errors="coerce").to_numpy())
        return seconds + DAY * np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -0.5 * DAY)
    parts = text.str.partition(" ")
    days = pandas.to_datetime(parts[0], format="%d.%m.%Y", errors="coerce")
    return seconds_of_moments((days + pandas.to_timedelta(parts[2].replace("", "0"), errors="coerce")).to_numpy())


def seconds_of_moments(moments: NDArray[Any]) -> NDArray[np.float64]:
    """Return durations, or dates relative to midnight of the first one, shape (n,) [s]; NaN where missing."""
    if moments.dtype.kind == "M":
        known = moments[~np.isnat(moments)]
        moments = moments - (known[0].astype("datetime64[D]") if known.size else np.datetime64(0, "D"))
    seconds: NDArray[np.float64] = moments / np.timedelta64(1, "s")
    return seconds
