"""Reading of LabVIEW's TDMS files with npTDMS: one channel per signal, each with its own times.

A waveform begins at its wf_start_time plus wf_start_offset and has a sample every wf_increment. A group may have a channel of
times instead, which then holds for all its channels of that length.
"""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import TIME, unit_of
from ehls_ros.recording.contained import check_library, contained, library_errors
from ehls_ros.recording.headers import recognised
from ehls_ros.recording.table import TIMES_IN_SECONDS, Pick, RawTable, check_length, unused
from ehls_ros.units import UNITS

LIBRARY = "nptdms"
"""Module that reads the files."""

EXPECTED_FILE = "a TDMS file"

UNIT_KEYS = ("unit_string", "NI_UnitDescription", "unit", "Unit")
"""Properties in which programs store a channel's unit."""

INCREMENT = "wf_increment"
"""Property with the sampling period of a waveform [s]."""

START, OFFSET = "wf_start_time", "wf_start_offset"
"""Properties with the beginning of a waveform: date and time, and seconds after it."""

UNSET_YEAR = np.datetime64("1905")
"""Year before which a date is LabVIEW's zero, 1904, of a start that was never set."""

UNSET_INCREMENT = 1.0
"""Sampling period of a waveform that was never set [s]."""

ABSCISSA_UNIT = "wf_xunit_string"
"""Property with the unit of a waveform's abscissa; missing for seconds."""

SAME_START = 1e-3
"""Difference of two starts, in periods, up to which waveforms have one time axis."""

WAVEFORM_TIME = "time"
"""Name of the time column derived from the waveforms' properties; further ones are numbered."""


def read_tdms(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a TDMS file.

    Args:
        path: the file. A channel is a column by its name, or as ``group/channel`` if several groups have one of that name.
            Waveforms also have time columns: ``time``, and ``time 2`` and so on if they differ in start, period or length.
        pick: returns the names of the columns to read; None for all.

    Returns:
        The table.

    Raises:
        BadInput: npTDMS is missing, or the file cannot be read.
    """
    check_library(LIBRARY, "npTDMS", path)
    return contained(read_here, path, pick, EXPECTED_FILE, RawTable, [LIBRARY])


def read_here(path: Path, pick: Pick | None) -> RawTable:
    """Read a TDMS file in this process, without a memory limit; see :func:`read_tdms`."""
    where = str(path)
    with library_errors("a TDMS file", where, EXPECTED_FILE), import_module(LIBRARY).TdmsFile.open(path) as file:
        return _table([channel for group in file.groups() for channel in group.channels()], pick, where)


class _Waveform(NamedTuple):
    """Times of a waveform: start after the zero of the file and period [s], and number of samples."""

    start: float
    period: float
    samples: int

    def times(self) -> NDArray[np.float64]:
        """Return the times of the samples [s]."""
        return self.start + self.period * np.arange(self.samples, dtype=np.float64)

    def same(self, other: "_Waveform") -> bool:
        """Return whether another waveform has these times."""
        near = abs(self.start - other.start) <= SAME_START * self.period
        return near and (self.period, self.samples) == (other.period, other.samples)


def _table(channels: list[Any], pick: Pick | None, where: str) -> RawTable:
    if not channels:
        raise BadInput("it has no channel", where, EXPECTED_FILE)  # as npTDMS finds in any file
    plain = [channel.name for channel in channels]
    by_name = {c.name if plain.count(c.name) == 1 else f"{c.group_name}/{c.name}": c for c in channels}
    units = {name: str(c.properties[key]) for name, c in by_name.items() for key in reversed(UNIT_KEYS) if key in c.properties}
    units |= {name: "s" for name, c in by_name.items() if c.dtype.kind in "mM"}
    time_of, remarks = _time_channels(by_name, units)
    others = {name: c for name, c in by_name.items() if name not in {*time_of, *time_of.values()}}
    unset = [
        name for name, c in others.items() if _period(c) == UNSET_INCREMENT and START in c.properties and _start(c) is None
    ]
    if unset:
        remarks.append(f"{', '.join(unset)}: {INCREMENT} of {UNSET_INCREMENT:g} s and {START} were never set and are not used")
    waveforms = {name: c for name, c in others.items() if _period(c) > 0.0 and name not in unset}
    moments = [by_name[name][0] for name in dict.fromkeys(time_of.values()) if by_name[name].dtype.kind == "M"]
    starts = {name: start for name, c in waveforms.items() if (start := _start(c)) is not None}
    zero = min([*moments, *starts.values()], default=None)
    if zero is not None and any(c.dtype.kind == "M" for c in by_name.values()):
        zero = zero.astype("datetime64[D]")
    if waveforms and time_of and not moments:
        remarks.append(f"the zero of {', '.join(dict.fromkeys(time_of.values()))} is taken to be the first {START}")
    axes = dict[str, _Waveform]()
    for name, channel in waveforms.items():
        start = starts.get(name)
        if start is None and starts:
            of_group = {starts[other] for other in starts if by_name[other].group_name == channel.group_name}
            if len(of_group) != 1:
                continue  # nothing says when it began
            start = of_group.pop()
            remarks.append(f"{name} has no {START} and is taken to begin with its group")
        after = 0.0 if start is None or zero is None else float((start - zero) / np.timedelta64(1, "s"))
        waveform = _Waveform(after + _number(channel, OFFSET) * _seconds(channel), _period(channel), len(channel))
        same = next((axis for axis, other in axes.items() if other.same(waveform)), None)
        time_of[name] = same or unused(WAVEFORM_TIME, {*by_name, *axes})
        axes.setdefault(time_of[name], waveform)
    if len(axes) == 1:
        [(axis, only)] = axes.items()
        remarks.append(f"{axis} is counted from the channels' {INCREMENT} of {only.period:g} s")
    elif axes:
        remarks.append(f"{', '.join(axes)} are counted from the channels' {START}, {OFFSET} and {INCREMENT}")
    names = (*by_name, *axes)
    wanted = names if pick is None else pick(names, time_of)
    lengths = [len(by_name[name]) if name in by_name else axes[name].samples for name in wanted]
    check_length(max(lengths, default=0), len(wanted), where)
    values = {name: axes[name].times() if name in axes else _values(by_name[name], zero, pick is None) for name in wanted}
    units |= dict.fromkeys(axes, "s")
    return RawTable(names, values, "sample", units=units, remarks=tuple(remarks), time_of=time_of)


def _time_channels(by_name: Mapping[str, Any], units: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """Return the channel of times of each channel of the groups that have one, and remarks."""
    stated: dict[tuple[str, int], str] = {}
    without_unit: dict[tuple[str, int], str] = {}
    for name, channel in by_name.items():
        unit, place = units.get(name, ""), (channel.group_name, len(channel))
        if not len(channel):
            continue
        if channel.dtype.kind == "M" or _is_time(channel, unit):
            stated.setdefault(place, name)
        elif not unit and _is_time(channel, "s"):
            without_unit.setdefault(place, name)
    # A map can name one column of times, and with it the unit, but not one of each group.
    guessed = {place: name for place, name in without_unit.items() if place not in stated}
    if len({channel.group_name for channel in by_name.values()}) < 2:
        guessed = {}
    times = stated | guessed
    of_channels = {name: times.get((c.group_name, len(c))) for name, c in by_name.items()}
    time_of = {name: time for name, time in of_channels.items() if time is not None and time != name}
    replaced = [name for name in time_of if INCREMENT in by_name[name].properties]
    remarks = [f"{', '.join(replaced)}: times of their group, not {INCREMENT}"] if replaced else []
    if guessed:
        remarks.append(f"{', '.join(guessed.values())}: {TIMES_IN_SECONDS}")
    return time_of, remarks


def _is_time(channel: Any, unit: str) -> bool:
    """Return whether a channel states with this unit that it holds times."""
    [header] = recognised([channel.name], {channel.name: unit})
    return header.signal == TIME and header.certainty in ("contract", "stated") and channel.dtype.kind in "fiu"


def _period(channel: Any) -> float:
    """Return the sampling period of a waveform [s]; zero for any other channel."""
    period = _number(channel, INCREMENT) * _seconds(channel)
    return period if len(channel) and channel.dtype.kind in "fiub" and 0.0 < period < np.inf else 0.0


def _seconds(channel: Any) -> float:
    """Return the unit of a waveform's abscissa [s]; zero if it is no time, as that of a spectrum."""
    unit = str(channel.properties.get(ABSCISSA_UNIT, "")) or "s"
    known = unit_of(unit)
    return UNITS[known].scale if known and UNITS[known].quantity == "time" else 0.0


def _number(channel: Any, name: str) -> float:
    """Return a property of a channel; zero if it is missing or not a finite number."""
    value = channel.properties.get(name, 0.0)
    return float(value) if isinstance(value, int | float | np.number) and np.isfinite(value) else 0.0


def _start(channel: Any) -> np.datetime64 | None:
    """Return the date and time of the beginning of a waveform; None if it is missing or was never set."""
    start = channel.properties.get(START)
    return start if isinstance(start, np.datetime64) and start >= UNSET_YEAR else None


def _values(channel: Any, zero: np.datetime64 | None, lenient: bool) -> NDArray[Any] | None:
    values = np.asarray(channel[:])
    if values.dtype.kind == "M" and zero is None:
        known = values[~np.isnat(values)]
        zero = known[0].astype("datetime64[D]") if known.size else np.datetime64(0, "D")
    if values.dtype.kind in "mM":
        seconds: NDArray[np.float64] = (values - zero if values.dtype.kind == "M" else values) / np.timedelta64(1, "s")
        return seconds
    return None if lenient and values.dtype.kind not in "fiub" else values
