"""Reading of MTS's RPC III time histories.

The header consists of records of 128 bytes, a keyword of 32 and a value of 96, in blocks of 512. The data are groups of
PTS_PER_GROUP points of each channel, one channel after the other; a group has several frames of PTS_PER_FRAME points. A value
of 16 bits times SCALE is the signal in its unit: SCALE already contains INT_FULL_SCALE. (Some readers multiply by
INT_FULL_SCALE / 2^15 as well, against MTS's description of the format.)
"""

from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording import limits
from ehls_ros.recording.limits import Deadline
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.recording.table import Pick, RawTable, check_length

EXPECTED_FILE = "a time history of RPC III (.rsp, .drv, .tim or .rpc)"

RECORD, KEYWORD, BLOCK = 128, 32, 512
"""Sizes of a record of the header, of its keyword, and of a block [B]."""

MAX_BLOCKS = 4096
"""Largest header [blocks]: the format has 256, and writers of many channels exceed that."""

MAX_CHANNELS = 1024
"""Maximum number of channels; the format has 256."""

BYTE_ORDERS: Mapping[str, str] = {"BINARY": "<", "BINARY_IEEE_LITTLE_END": "<", "BINARY_IEEE_BIG_END": ">"}
"""Byte order by FORMAT; BINARY is that of the PC and the VAX."""

TYPES: Mapping[str, str] = {"SHORT_INTEGER": "i2", "FLOATING_POINT": "f4", "DOUBLE_PRECISION": "f8"}
"""Type of the values by DATA_TYPE; the last is of some writers."""

TIME_COLUMN = "time"
"""Name of the time column, which is counted from DELTA_T."""


Points = NDArray[np.int16] | NDArray[np.float32] | NDArray[np.float64]
"""Values as stored."""


class _History(NamedTuple):
    """Place of the data in a file.

    Attributes:
        begin: size of the header [B].
        dtype: type of the values.
        channels: number of channels.
        group: points of a channel in a group.
        stored: points of a channel in all frames, with half frames.
        last: points of a channel in the last group.
        margin: points of half a frame, at both ends, which contain no data.
        samples: points of a channel that are data.
        period: sampling period [s].
    """

    begin: int
    dtype: np.dtype[np.int16] | np.dtype[np.float32] | np.dtype[np.float64]
    channels: int
    group: int
    stored: int
    last: int
    margin: int
    samples: int
    period: float

    @property
    def groups(self) -> int:
        """Number of groups."""
        return -(-self.stored // self.group)

    def read(self, stream: BinaryIO, channel: int, first: int = 0) -> Points:
        """Return the stored points of a channel, numbered from 0, from a group on."""
        parts = []
        for k in range(first, self.groups):
            points = self.last if k == self.groups - 1 else self.group
            before = k * self.group * self.channels + channel * points
            stream.seek(self.begin + before * self.dtype.itemsize)
            parts.append(np.frombuffer(stream.read(points * self.dtype.itemsize), dtype=self.dtype))
        return np.concatenate(parts)[: self.stored - first * self.group]

    def fill(self, stream: BinaryIO) -> int:
        """Return the number of points at the end that fill the last group: all channels repeat one value there, or zero."""
        last = np.array([self.read(stream, channel, self.groups - 1) for channel in range(self.channels)])
        last = last[:, : last.shape[1] - self.margin]
        if not last.size:
            return 0
        different = np.flatnonzero(np.any(last != last[:, -1:], axis=0))
        if not len(different):
            return 0  # a group that is constant, such as the end of a hold
        run = last.shape[1] - 1 - int(different[-1])
        fill = run if not np.any(last[:, -1]) else run - 1
        return fill if fill > 1 else 0


def read_rpc(path: Path, pick: Pick | None = None) -> RawTable:
    """Read an RPC III time history.

    Args:
        path: the file. A channel is a column by its description, or as ``channel 3`` without one; ``description (channel 3)``
            if it occurs twice. The column ``time`` is counted from the sampling period.
        pick: returns the names of the columns to read; None for all.

    Returns:
        The table. Constant values that fill the last group are left out, with a remark.

    Raises:
        BadInput: the file cannot be read, is no time history, or does not have the size that its header states.
    """
    where = str(path)
    size = check_regular(path, limits.TABLE, EXPECTED_FILE, larger=limits.TABLE_LARGER)
    deadline = Deadline(size, where)
    try:
        with path.open("rb") as stream:
            header = _header(stream, size, where)
            history = _history(header, size, where)
            names = _names(header, history.channels)
            time_of = dict.fromkeys(names, TIME_COLUMN)
            wanted = (*names, TIME_COLUMN) if pick is None else pick((*names, TIME_COLUMN), time_of)
            check_length(history.stored, len(wanted), where)
            fill = history.fill(stream) if wanted and "SAMPLES" not in header else 0
            points: dict[str, Points] = {}
            for name in wanted:
                deadline.check()
                if name in time_of:
                    points[name] = history.read(stream, names.index(name))
    except OSError as error:
        raise BadInput(f"the file cannot be read ({reason(error)})", where, EXPECTED_FILE) from None
    part = slice(history.margin, history.margin + history.samples - fill)
    values = {name: _scaled(found[part], header, names.index(name), where) for name, found in points.items()}
    if TIME_COLUMN in wanted:
        values[TIME_COLUMN] = np.arange(history.samples - fill, dtype=np.float64) * history.period
    remarks = [f"{TIME_COLUMN} is counted from DELTA_T of {history.period:g} s"]
    if history.margin:
        shown = f"the first and last {history.margin} values"
        remarks.append(f"{shown} are half frames, which contain no data, and are left out")
    if fill:
        remarks.append(f"the last {fill} values of each channel are constant, as they fill the last group, and are left out")
    units = {name: header.get(f"UNITS.CHAN_{k + 1}", "") for k, name in enumerate(names)}
    given = {name: unit for name, unit in units.items() if unit and unit != "NONE"}
    return RawTable(
        (*names, TIME_COLUMN), values, "sample", units={**given, TIME_COLUMN: "s"}, remarks=tuple(remarks), time_of=time_of
    )


def _header(stream: BinaryIO, size: int, where: str) -> dict[str, str]:
    """Return the values of the header by keyword."""
    first = [_record(stream.read(RECORD)) for _ in range(3)]
    if [keyword for keyword, _ in first] != ["FORMAT", "NUM_HEADER_BLOCKS", "NUM_PARAMS"]:
        raise BadInput("it does not begin with FORMAT, NUM_HEADER_BLOCKS and NUM_PARAMS", where, EXPECTED_FILE)
    header = dict(first)
    blocks = _integer(header, "NUM_HEADER_BLOCKS", 1, MAX_BLOCKS, where)
    count = _integer(header, "NUM_PARAMS", 3, blocks * (BLOCK // RECORD), where)
    if blocks * BLOCK > size:
        what = f"its header has {blocks} blocks of {BLOCK} bytes, and the file has {size} bytes"
        raise BadInput(what, where, f"{EXPECTED_FILE}, whole")
    return header | dict(filter(lambda record: record[0], (_record(stream.read(RECORD)) for _ in range(count - 3))))


def _record(content: bytes) -> tuple[str, str]:
    keyword, value = (part.partition(b"\0")[0].decode("cp1252", "replace") for part in (content[:KEYWORD], content[KEYWORD:]))
    return keyword.strip().upper(), value.strip().strip('"').strip()


def _history(header: Mapping[str, str], size: int, where: str) -> _History:
    """Return the place of the data; reject a header that does not fit the size of the file."""
    for keyword, allowed, default in (
        ("FORMAT", tuple(BYTE_ORDERS), ""),
        ("FILE_TYPE", ("TIME_HISTORY",), "TIME_HISTORY"),
        ("DATA_TYPE", tuple(TYPES), "SHORT_INTEGER"),
    ):
        found = header.get(keyword, default)
        if found not in allowed:
            raise BadInput(f"{keyword} is {found}", where, f"{' or '.join(allowed)}; convert it, or save it as CSV")
    dtype = np.dtype(BYTE_ORDERS[header["FORMAT"]] + TYPES[header.get("DATA_TYPE", "SHORT_INTEGER")])
    channels = _integer(header, "CHANNELS", 1, MAX_CHANNELS, where)
    frame = _integer(header, "PTS_PER_FRAME", 1, size, where)
    group = _integer(header, "PTS_PER_GROUP", frame, size, where)
    frames = _integer(header, "FRAMES", 1, size, where)
    half = _integer(header, "HALF_FRAMES", 0, 1, where, default=0)
    period = _number(header, "DELTA_T", where)
    if not 0.0 < period < np.inf:
        raise BadInput(f"DELTA_T is {period:g}", where, "the sampling period, in s")
    begin = int(header["NUM_HEADER_BLOCKS"]) * BLOCK
    # FRAMES counts the half frames or not. Some writers fill the last group, others end with its last frame; a rest of the last
    # block may follow.
    layouts = [
        (stored, last, channels * (whole + last) * dtype.itemsize)
        for stored in ((frames + half) * frame, frames * frame)
        for whole in [(stored - 1) // group * group]
        for last in (group, stored - whole)
    ]
    stored, last, full = next((layout for layout in layouts if 0 <= size - begin - layout[2] < BLOCK), layouts[0])
    if not 0 <= size - begin - full < BLOCK:
        data = f"{channels} channels, {stored} points of {dtype.itemsize} bytes"
        what = f"its header states {full} bytes of data ({data}), and {size - begin} follow"
        raise BadInput(what, where, f"{EXPECTED_FILE}, whole")
    margin = half * frame // 2
    samples = stored - 2 * margin
    samples = _integer(header, "SAMPLES", 1, samples, where, default=samples)  # of some writers
    return _History(begin, dtype, channels, group, stored, last, margin, samples, period)


def _names(header: Mapping[str, str], channels: int) -> list[str]:
    described = [header.get(f"DESC.CHAN_{k + 1}", "") or f"channel {k + 1}" for k in range(channels)]
    taken = {TIME_COLUMN, *(name for name in described if described.count(name) > 1)}
    return [f"{name} (channel {k + 1})" if name in taken else name for k, name in enumerate(described)]


def _scaled(points: Points, header: Mapping[str, str], channel: int, where: str) -> NDArray[np.float64]:
    scale = _number(header, f"SCALE.CHAN_{channel + 1}", where) if points.dtype.kind == "i" else 1.0
    return points.astype(np.float64) * scale


def _integer(header: Mapping[str, str], keyword: str, least: int, most: int, where: str, default: int | None = None) -> int:
    if keyword not in header and default is not None:
        return default
    value = _number(header, keyword, where)
    if not (value.is_integer() and least <= value <= most):
        raise BadInput(f"{keyword} is {header[keyword]}", where, f"an integer from {least} to {most}")
    return int(value)


def _number(header: Mapping[str, str], keyword: str, where: str) -> float:
    if keyword not in header:
        raise BadInput(f"{keyword} is missing in its header", where, EXPECTED_FILE)
    try:
        value = float(header[keyword])
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise BadInput(f"{keyword} is {header[keyword]!r}", where, "a number")
    return value
