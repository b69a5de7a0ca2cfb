"""Sample times from clock texts and dates, and from the times of reception of messages."""

from importlib import import_module
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

DAY = 86400.0
"""Length of a day [s]."""


Times = NDArray[np.float64]

SMOOTHED = 2.0
"""Time over which the delay of messages is averaged [s]; the clock drift between sender and recorder is slower."""

AROUND = 20
"""Number of messages before and after one whose delays distinguish lost messages from late ones."""

LOST = 0.5
"""Change of the delay, in periods, above which messages were lost."""

EVEN = 0.5
"""Largest standard deviation of the delay, in periods, up to which messages were sent evenly."""


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


def sent_evenly(received: Times) -> Times | None:
    """Return the sending times of evenly sent messages, plus their mean delay.

    Args:
        received: times of reception, increasing, shape (n,) [s].

    Returns:
        Their times, shape (n,) [s]; None if they were not sent evenly.
    """
    if len(received) <= 4 * AROUND:
        return None
    # Over many messages the delays hardly matter, and losses are rare.
    period = float(np.median(received[2 * AROUND :] - received[: -2 * AROUND])) / (2 * AROUND)
    late = received - period * np.arange(len(received))
    # A late message does not delay others for long; a lost one shifts all later ones forward.
    usual = np.pad(scipy.ndimage.median_filter(late, AROUND), AROUND // 2, mode="edge")
    change = (usual[AROUND:] - usual[:-AROUND]) / period
    steps, lost = np.diff(received, prepend=received[0]), np.zeros(len(received))
    for place in scipy.signal.find_peaks(change, height=LOST, distance=AROUND)[0]:
        begin = max(0, place - AROUND // 2)
        lost[begin + np.argmax(steps[begin : place + AROUND // 2])] = np.round(change[place])
    number = np.arange(len(received)) + np.cumsum(lost)
    slope, start = np.polyfit(number, received - received[0], 1)
    even: Times = received[0] + start + slope * number
    window = max(1, round(SMOOTHED / period))
    even = even + scipy.ndimage.uniform_filter1d(received - even, min(window, len(received)), mode="nearest")
    return even if float(np.std(received - even)) <= EVEN * period and bool(np.all(np.diff(even) > 0.0)) else None
