"""Sample times from clock texts and dates, and from the times of reception of messages."""

import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

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


MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
GERMAN_MONTHS: Mapping[str, str] = {"mär": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec"}

CLOCK = re.compile(
    r"(?=.)"
    r"(?P<dated>(?:(?P<year>\d{4})(?P<dash>[-/.])(?P<month>\d{1,2})(?P=dash)(?P<day>\d{1,2})"
    r"|(?P<one>\d{1,2})(?P<mark>[-/.])(?P<two>\d{1,2})(?P=mark)(?P<years>\d{4}|\d\d)"
    r"|(?P<date>\d{1,2})[- .](?P<word>[A-Za-zä]{3})\.?[- ](?P<wordyear>\d{4}))(?:[T ]\s*|\Z))?"
    r"(?:(?P<hour>\d{1,2}):(?P<minute>\d\d)"
    r"(?::(?P<second>\d\d)(?:(?P<sign>[.,:])(?P<part>\d{1,9})\d*)?|(?(dated)|(?=\s*[AaPp]\.?[Mm])))"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?(?:\s*(?P<zone>Z|UTC|GMT|[-+]\d\d:?\d\d))?)?\Z"
)
"""A date, a time of day or both. A time without seconds needs a date or a half of the day."""

ISO, PLAIN = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d:\d\d([.,]\d+)?Z?)?\Z"), re.compile(r"\d{1,2}:\d\d:\d\d([.,]\d+)?\Z")
"""Formats that pandas reads fast."""


class Clock(NamedTuple):
    """Times of a column of clock times.

    Attributes:
        seconds: times since midnight of the first day, shape (n,) [s]; NaN for invalid cells.
        remark: the order of day and month, if it was decided by the rows; otherwise empty.
    """

    seconds: Times
    remark: str = ""


def seconds_of_clock(cells: NDArray[Any]) -> Clock:
    """Return the times of a column of clock times.

    Args:
        cells: texts such as ``12:03:04,125``, ``12:03:04:125``, ``11:59:01 PM``, ``2026-05-01T12:03:04.125+01:00``,
            ``1.5.2026 12:03:04``, ``5/1/2026 12:03:04 PM`` or ``01-May-2026 12:03:04``, shape (n,).

    Returns:
        Their times. A time of day that falls by over half a day belongs to the next day. Of day/month/year and
        month/day/year, the order is chosen in which all dates exist and the days follow each other. Offsets from UTC count
        relative to that of the first row.
    """
    pandas: Any = import_module("pandas")
    text = pandas.Series(cells, dtype=str).str.strip()
    first = next((cell for cell in text if isinstance(cell, str) and cell), "")
    if ISO.match(first) or PLAIN.match(first):
        plain = text.str.replace(",", ".", regex=False).str.removesuffix("Z")
        read = pandas.to_datetime(plain, format="ISO8601", errors="coerce") if "-" in first else None
        if read is None or read.dtype.kind == "M":
            moments = (pandas.to_timedelta(plain, errors="coerce") if read is None else read).to_numpy()
            if np.array_equal(np.isnat(moments), text.isna().to_numpy()):
                seconds = seconds_of_moments(moments)
                return Clock(_over_midnight(seconds) if read is None else seconds)
    parts = text.str.extract(CLOCK)

    def number(name: str, otherwise: float = np.nan) -> Times:
        return np.asarray(pandas.to_numeric(parts[name], errors="coerce").fillna(otherwise), dtype=np.float64)

    known = text.str.fullmatch(CLOCK).fillna(value=False).to_numpy(dtype=bool)
    half = parts["half"].str.lower().to_numpy()
    hours = number("hour", 0.0)
    hours = np.where(pandas.isna(half), hours, hours % 12.0 + 12.0 * (half == "p"))
    digits = parts["part"].str.len().fillna(0.0).to_numpy(dtype=np.float64)
    # Digits beyond nanoseconds are left out. Behind a colon are milliseconds, or microseconds of six digits, maybe not padded.
    colon = 3.0 * np.ceil(max(digits.max(initial=0.0), 1.0) / 3.0)
    fraction = number("part", 0.0) / 10.0 ** np.where(parts["sign"].to_numpy() == ":", colon, digits)
    seconds = 3600.0 * hours + 60.0 * number("minute", 0.0) + number("second", 0.0) + fraction
    zone = _minutes_of_zone(parts["zone"])
    seconds -= 60.0 * (zone - zone[known][0]) if known.any() else 0.0
    seconds[~known] = np.nan
    dated = ~np.isnan(number("year")) | ~np.isnan(number("one")) | ~np.isnan(number("date"))
    if not dated.any():
        return Clock(_over_midnight(seconds))
    words = parts["word"].str.lower().replace(dict(GERMAN_MONTHS)).map({month: k + 1 for k, month in enumerate(MONTHS)})
    years = number("years")
    years = np.where(years < 100.0, years + 2000.0, years)
    fixed = _days(number("year"), number("month"), number("day"))
    fixed = np.where(np.isnan(fixed), _days(number("wordyear"), words.to_numpy(dtype=np.float64), number("date")), fixed)
    orders = {
        "day/month/year": _days(years, number("two"), number("one")),
        "month/day/year": _days(years, number("one"), number("two")),
    }
    if (parts["mark"] == ".").any():
        del orders["month/day/year"]
    days = {name: np.where(np.isnan(fixed), read, fixed) for name, read in orders.items()}
    missing = {name: int(np.count_nonzero(np.isnan(read[known]))) for name, read in days.items()}
    jumps = {name: float(np.nansum(np.abs(np.diff(read[known])))) for name, read in days.items()}
    chosen = min(days, key=lambda name: (missing[name], jumps[name]))
    ambiguous = len(days) > 1 and len(set(missing.values())) == 1 and len(set(jumps.values())) > 1
    remark = f"dates such as '{first}' are read as {chosen}, in which the days follow each other" if ambiguous else ""
    begin = next(iter(days[chosen][np.isfinite(days[chosen])]), 0.0)
    return Clock(seconds + DAY * (days[chosen] - begin), remark)


def _over_midnight(seconds: Times) -> Times:
    steps = np.diff(seconds, prepend=seconds[:1])
    return seconds + DAY * np.cumsum(steps < -0.5 * DAY)


def _minutes_of_zone(zones: Any) -> Times:
    """Return offsets from UTC, shape (n,) [min]."""
    parts = zones.str.extract(r"(?P<sign>[-+])(?P<hours>\d\d):?(?P<minutes>\d\d)")
    size = 60.0 * parts["hours"].astype(float) + parts["minutes"].astype(float)
    return np.asarray((size * np.where(parts["sign"] == "-", -1.0, 1.0)).fillna(0.0), dtype=np.float64)


def _days(year: Times, month: Times, day: Times) -> Times:
    """Return days since 1970, shape (n,); NaN where there is no such date."""
    right = np.isfinite(year) & (month >= 1.0) & (month <= 12.0) & (day >= 1.0) & (day <= 31.0)
    months = (12.0 * (np.where(right, year, 1970.0) - 1970.0) + np.where(right, month, 1.0) - 1.0).astype("datetime64[M]")
    first = months.astype("datetime64[D]")
    lengths = ((months + 1).astype("datetime64[D]") - first).astype(np.float64)
    return np.where(right & (day <= lengths), first.astype(np.float64) + day - 1.0, np.nan)


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
