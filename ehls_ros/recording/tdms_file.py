"""Reading of LabVIEW's TDMS files with npTDMS: one channel per signal."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.contained import check_library, contained, library_errors
from ehls_ros.recording.table import Pick, RawTable, check_length
from ehls_ros.recording.times import seconds_of_moments

LIBRARY = "nptdms"
"""Module that reads the files."""

EXPECTED_FILE = "a TDMS file"

UNIT_KEYS = ("unit_string", "NI_UnitDescription", "unit", "Unit")
"""Properties in which programs store a channel's unit."""

INCREMENT = "wf_increment"
"""Property with the sampling period of a waveform [s]."""

WAVEFORM_TIME = "time"
"""Name of the time column derived from the waveforms' sampling period."""


def read_tdms(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a TDMS file.

    Args:
        path: the file. A channel is a column by its name, or as ``group/channel`` if several groups have one of that name.
            Waveforms of one sampling period also have a time column.
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


def _table(channels: list[Any], pick: Pick | None, where: str) -> RawTable:
    if not channels:
        raise BadInput("it has no channel", where, EXPECTED_FILE)  # as npTDMS finds in any file
    plain = [channel.name for channel in channels]
    by_name = {c.name if plain.count(c.name) == 1 else f"{c.group_name}/{c.name}": c for c in channels}
    steps = {float(c.properties[INCREMENT]) for c in channels if INCREMENT in c.properties}
    lengths = {len(c) for c in channels if INCREMENT in c.properties}
    even = len(steps) == 1 and len(lengths) == 1 and WAVEFORM_TIME not in by_name
    names = (*by_name, WAVEFORM_TIME) if even else tuple(by_name)
    wanted = names if pick is None else pick(names)
    check_length(max((len(by_name[name]) for name in wanted if name in by_name), default=0), len(wanted), where)
    values = {name: _values(by_name[name], pick is None) for name in wanted if name in by_name}
    times = {name: "s" for name, c in by_name.items() if c.dtype.kind in "mM"}
    remarks: tuple[str, ...] = ()
    if even:
        step = steps.pop()
        remarks = (f"{WAVEFORM_TIME} is counted from the channels' {INCREMENT} of {step:g} s",)
        times[WAVEFORM_TIME] = "s"
        values[WAVEFORM_TIME] = np.arange(lengths.pop()) * step
    units = {name: str(c.properties[key]) for name, c in by_name.items() for key in reversed(UNIT_KEYS) if key in c.properties}
    return RawTable(names, values, "sample", units={**units, **times}, remarks=remarks)


def _values(channel: Any, lenient: bool) -> NDArray[Any] | None:
    values = np.asarray(channel[:])
    if values.dtype.kind in "mM":
        return seconds_of_moments(values)
    return None if lenient and values.dtype.kind not in "fiub" else values
