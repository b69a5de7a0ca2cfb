"""Reading of LabVIEW's measurement files: a header for the file, and one for each segment above its values.

The times of a channel are columns of the file (``X_Columns`` One or Multi), or follow from ``X0`` and ``Delta_X`` of the
segment's header (No). They count from the date and time of the segment.
"""

import datetime as dt
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording import limits
from ehls_ros.recording.columns import unique_names
from ehls_ros.recording.csv_file import EXPECTED_FILE as EXPECTED_TEXT
from ehls_ros.recording.csv_file import SAMPLE, Block, ParsedColumns, physical_lines
from ehls_ros.recording.limits import Deadline
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.recording.table import NONE, Pick, RawTable, check_length
from ehls_ros.recording.table_layout import BEGINNING, Header, Kind, Layout, encoding_of, split

MAGIC = "LabVIEW Measurement"
"""Beginning of a file with headers."""

EXPECTED_FILE = "a LabVIEW measurement file, or the data as CSV"

END, START_SPECIAL, END_SPECIAL = "***End_of_Header***", "***Start_Special***", "***End_Special***"

SEGMENT_KEYS = ("Channels", "Notes", "Samples", "Date", "Time", "Y_Unit_Label", "X_Dimension", "X0", "Delta_X", "Test_Name")
"""First cells of lines of a segment's header."""

COMMENT = "Comment"
"""Name of the last column, which has texts in some rows."""

X_VALUE = "X_Value"
"""Name of the columns of times."""

SAME = 1e-9
"""Difference below which two times or steps are the same, relative to the step."""


class _Segment(NamedTuple):
    """Segment of a file: cells of its header by key, names of its columns, and its lines of values."""

    header: Mapping[str, Sequence[str]]
    names: tuple[str, ...]
    lines: list[str]
    first: int

    def cells(self, key: str, place: int, otherwise: str = "") -> str:
        """Return the cell of the header in a column."""
        row = self.header.get(key, ())
        return row[place].strip() if place < len(row) and row[place].strip() else otherwise


class _File(NamedTuple):
    layout: Layout
    x_columns: str
    segments: list[_Segment]


def is_lvm(path: Path) -> bool:
    """Return whether a file begins as a LabVIEW measurement file does; if not, it is a plain table.

    Raises:
        BadInput: the file cannot be read, or is a pipe or a device.
    """
    check_regular(path, limits.TABLE, EXPECTED_TEXT, larger=limits.TABLE_LARGER)
    try:
        with path.open("rb") as stream:
            content = stream.read(200)
    except OSError as error:
        raise BadInput(f"the file cannot be read ({reason(error)})", str(path), EXPECTED_TEXT) from None
    return MAGIC in content.decode(encoding_of(content, whole=False), errors="replace")[: len(MAGIC) + 2]


def read_lvm(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a LabVIEW measurement file.

    Args:
        path: the file. Its segments are joined by their times.
        pick: returns the names of the columns to read, whose cells must be numbers or empty; None: all columns, where one with
            any other cell becomes None.

    Returns:
        The table, with one time column, or with one for each group of channels of equal times.

    Raises:
        BadInput: the file cannot be read, its segments differ, or a row or cell is wrong.
    """
    where = str(path)
    deadline = Deadline(check_regular(path, limits.TABLE, EXPECTED_FILE, larger=limits.TABLE_LARGER), where)
    try:
        with path.open("rb") as stream:
            content = stream.read(BEGINNING)
            whole = not stream.read(1)
        file = _split(physical_lines(path, encoding_of(content, whole), deadline), encoding_of(content, whole), where)
    except OSError as error:
        raise BadInput(f"the file cannot be read ({reason(error)})", where, EXPECTED_FILE) from None
    return _table(file, pick, deadline, where)


def _split(lines: Iterator[str], encoding: str, where: str) -> _File:
    """Split a file into its header and its segments."""
    keys = dict[str, str]()
    numbered = enumerate(lines, start=1)
    for _, line in numbered:
        key, *value = re.split(r"[\t,;]", line, maxsplit=1)
        if key.strip() == END:
            break
        text = "".join(value).strip()
        # Cells that the header leaves empty may be delimited.
        keys[key.strip()] = text if len(text) == 1 else text.rstrip("\t,; ")
    else:
        raise BadInput(f"its header has no line {END}", where, EXPECTED_FILE)
    delimiter = {"comma": ",", "tab": "\t"}.get(keys.get("Separator", "Tab").lower(), "\t")
    segments = list(_segments(numbered, delimiter, where))
    # Old versions write numbers with a point and times with a comma, and no Decimal_Separator.
    shown = any("," in line for segment in segments[:1] for line in segment.lines[:SAMPLE])
    decimal = keys.get("Decimal_Separator", "").strip() or ("," if shown and delimiter != "," else ".")
    if decimal not in (".", ",") or decimal == delimiter:
        raise BadInput(f"Decimal_Separator is {decimal!r} and cells are separated by it", where, "another separator on export")
    layout = Layout(encoding, delimiter, decimal, Header((), {}, None, None, 0, ()))
    return _File(layout, keys.get("X_Columns", "No").lower(), segments)


def _segments(lines: Iterator[tuple[int, str]], delimiter: str, where: str) -> Iterator[_Segment]:
    header = dict[str, Sequence[str]]()
    current: _Segment | None = None
    named = False
    for number, line in _without_special(lines):
        cells = split(line, delimiter)
        key = cells[0].strip()
        if named:
            # The line below a header has the names.
            current, named, header = _Segment(header, _names(cells, number, where), [], number + 1), False, {}
        elif key == END or key in SEGMENT_KEYS:
            if current is not None and current.lines:
                yield current
            current, named = None, key == END
            header |= {} if named else {key: cells}
        elif current is not None and line.strip():
            current.lines.append(_row(cells, line, current, number, delimiter, where))
            check_length(len(current.lines), len(current.names), where)
    if current is not None and current.lines:
        yield current


def _without_special(lines: Iterator[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Leave out the blocks of other data that a program may add."""
    special = False
    for number, line in lines:
        bare = line.strip()
        special = bare == START_SPECIAL or (special and bare != END_SPECIAL)
        if not special and bare != END_SPECIAL:
            yield number, line


def _names(cells: Sequence[str], number: int, where: str) -> tuple[str, ...]:
    names = [cell.strip() for cell in cells]
    while names and names[-1] in ("", COMMENT):
        names.pop()
    if len(names) < 2:
        raise BadInput("there are no names of channels", f"{where}, line {number}", f"{X_VALUE}, and a name for each")
    return tuple(names)


def _row(cells: Sequence[str], line: str, segment: _Segment, number: int, delimiter: str, where: str) -> str:
    """Return a line of values without its comment, and with the cells left out for channels that have ended."""
    width, count = len(segment.names), len(cells)
    if count == width:
        return line
    if count == width + 1 or (count > width and not any(map(str.strip, cells[width + 1 :]))):
        return delimiter.join(cells[:width])
    # A column of times has no cell of its own in the header.
    samples = [text for k in range(count, width) if (text := segment.cells("Samples", k))]
    ended = all(_count(text) <= len(segment.lines) for text in samples)
    if 1 < count < width and ended and segment.cells("Samples", width - 1):
        return delimiter.join([*cells, *[""] * (width - count)])
    what = f"the row has {count} cells"
    raise BadInput(what, f"{where}, line {number}", f"{width}, as in the line of names, with a comment or without")


def _table(file: _File, pick: Pick | None, deadline: Deadline, where: str) -> RawTable:
    if not file.segments:
        raise BadInput("it has no values", where, EXPECTED_FILE)
    first = file.segments[0]
    for segment in file.segments[1:]:
        if segment.names != first.names:
            what = f"the channels are {', '.join(segment.names[1:])}, and above {', '.join(first.names[1:])}"
            raise BadInput(what, f"{where}, line {segment.first}", "segments with the same channels; split the file there")
    multi = file.x_columns == "multi"
    channels = [place for place in range(1, len(first.names)) if not multi or place % 2]
    labels = [first.names[place] for place in channels]
    reader = _Reader(file, deadline, where)
    times = _times(file, channels, reader, where)
    axes = _distinct(times)
    texts = {first.cells("X_Dimension", place, "Time") for place in channels}
    base = "time" if file.x_columns == "no" and "time" not in labels else X_VALUE
    if texts != {"Time"}:
        base = next(iter(texts - {"Time"}))
    axis_names = [base if k == 0 else f"{base} {k + 1}" for k in range(len(axes.values))]
    # As in the file, the first column has times.
    names = (axis_names[0], *labels, *axis_names[1:])
    unique = unique_names(names)
    axis_keys = [unique[0], *unique[1 + len(labels) :]]
    keys = dict(zip(unique[1 : 1 + len(labels)], channels, strict=True))
    time_of = dict(zip(keys, (axis_keys[k] for k in axes.of_channel), strict=True)) if len(axis_keys) > 1 else {}
    wanted = unique if pick is None else pick(names, time_of or NONE)
    places = {name: place for name, place in keys.items() if name in wanted}
    read = reader.columns(sorted(places.values()), lenient=pick is None)
    values: dict[str, NDArray[np.float64] | None] = {}
    for name, place in places.items():
        column = read[place]
        values[name] = None if column is None else column[: len(times[channels.index(place)])]
    values |= {name: axis for name, axis in zip(axis_keys, axes.values, strict=True) if name in wanted}
    units = {name: first.cells("Y_Unit_Label", place) for name, place in keys.items()}
    units |= dict.fromkeys(axis_keys, "s" if texts == {"Time"} else "")
    begins = np.cumsum([0, *(len(segment.lines) for segment in file.segments)])
    blocks = tuple((int(row), s.first) for row, s in zip(begins[1:-1], file.segments[1:], strict=True))
    wrong = {name: reader.wrong[place] for name, place in places.items() if place in reader.wrong}
    stated = {name: unit for name, unit in units.items() if unit}
    return RawTable(names, values, "line", first.first, stated, tuple(_remarks(file, channels)), wrong, time_of, blocks)


class _Reader:
    """Parser of the columns of all segments."""

    def __init__(self, file: _File, deadline: Deadline, where: str) -> None:
        self._file, self._deadline, self._where = file, deadline, where
        self.wrong: dict[int, str] = {}

    def columns(self, places: Sequence[int], lenient: bool) -> dict[int, NDArray[np.float64] | None]:
        """Return columns by their places in the file."""
        if not places:
            return {}
        names = self._file.segments[0].names
        kinds: list[Kind] = ["number"] * len(names)
        header = Header(names, {}, None, None, 0, tuple(kinds))
        columns = ParsedColumns(self._file.layout._replace(header=header), places, lenient, self._deadline, self._where)
        found = columns.read(Block(segment.lines, segment.first) for segment in self._file.segments)
        self.wrong |= columns.wrong
        return found


class _Axes(NamedTuple):
    """Distinct time axes, and the index of that of each channel."""

    values: list[NDArray[np.float64]]
    of_channel: list[int]


def _distinct(times: Sequence[NDArray[np.float64]]) -> _Axes:
    values, of_channel = list[NDArray[np.float64]](), list[int]()
    for time in times:
        place = next((k for k, other in enumerate(values) if _same(other, time)), len(values))
        if place == len(values):
            values.append(time)
        of_channel.append(place)
    return _Axes(values, of_channel)


def _same(time: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether two time axes are the same, apart from rounding."""
    if len(time) != len(other) or not np.array_equal(np.isfinite(time), np.isfinite(other)):
        return False
    known = time[np.isfinite(time)]
    step = float(np.median(np.abs(np.diff(known)))) if len(known) > 1 else 1.0
    return bool(np.all(np.abs(known - other[np.isfinite(other)]) <= SAME * (1.0 + step)))


def _times(file: _File, channels: Sequence[int], reader: _Reader, where: str) -> list[NDArray[np.float64]]:
    """Return the times of each channel."""
    starts = [[_start(segment, place, where) for place in channels] for segment in file.segments]
    zero = min(chain.from_iterable(starts))
    offsets = np.array([[(start - zero).total_seconds() for start in row] for row in starts])
    if file.x_columns == "no":
        return _counted(file, channels, offsets, where)
    places = [place - 1 if file.x_columns == "multi" else 0 for place in channels]
    columns = reader.columns(sorted(set(places)), lenient=False)
    lengths = [len(segment.lines) for segment in file.segments]
    begins = np.cumsum([0, *lengths])
    out = []
    for k, place in enumerate(places):
        written = columns[place]
        assert written is not None  # noqa: S101 - read without leniency
        time = written + np.repeat(offsets[:, k], lengths)
        known = np.isfinite(written)
        # The times of segments either begin anew in each, or go on, and then need no offset.
        if all(begin == 0 or written[begin] > written[begin - 1] for begin in begins[:-1]):
            time = written + offsets[0, k]
        out.append(time if file.x_columns == "one" else time[: _last(known)])
    return out


def _last(known: NDArray[np.bool_]) -> int:
    return int(np.flatnonzero(known)[-1]) + 1 if known.any() else 0


def _counted(file: _File, channels: Sequence[int], offsets: NDArray[np.float64], where: str) -> list[NDArray[np.float64]]:
    """Return the times that follow from X0 and Delta_X; channels of one rate and start have the length of the longest."""
    decimal = file.layout.decimal

    def number(segment: _Segment, key: str, place: int, otherwise: str) -> float:
        text = segment.cells(key, place, otherwise)
        try:
            return float(text.replace(decimal, "."))
        except ValueError:
            what = f"{key} is {text[:40]!r}"
            raise BadInput(what, f"{where}, header above line {segment.first}", "a number for each channel") from None

    def parts(k: int, place: int, longest: bool) -> Iterator[NDArray[np.float64]]:
        for segment, row in zip(file.segments, offsets, strict=True):
            count = len(segment.lines)
            samples = segment.cells("Samples", place, str(count))
            if not longest and len(file.segments) == 1:
                count = min(count, _count(samples))
            start = row[k] + number(segment, "X0", place, "0")
            yield start + number(segment, "Delta_X", place, "1") * np.arange(count)

    steps = {number(s, "Delta_X", place, "1") for s in file.segments for place in channels if _has_samples(s, place)}
    starts = {
        row[k] + number(s, "X0", p, "0") for s, row in zip(file.segments, offsets, strict=True) for k, p in enumerate(channels)
    }
    common = len(steps) <= 1 and len(starts) <= len(file.segments)
    return [np.concatenate(list(parts(k, place, common))) for k, place in enumerate(channels)]


def _count(text: str) -> int:
    """Return a number of samples; one that cannot be, for other texts."""
    return int(text) if text.isdecimal() and len(text) < len(str(sys.maxsize)) else sys.maxsize


def _has_samples(segment: _Segment, place: int) -> bool:
    return segment.cells("Samples", place, "1") != "0"


def _start(segment: _Segment, place: int, where: str) -> dt.datetime:
    """Return the start of a channel in a segment."""
    date = re.split(r"[-/.]", segment.cells("Date", place, segment.cells("Date", 1, "2000/01/01")))
    clock = re.split(r"[:]", segment.cells("Time", place, segment.cells("Time", 1, "0:00:00")).replace(",", "."))
    try:
        year, month, day_of_month = map(int, date if len(date[0]) == 4 else reversed(date))
        day = dt.datetime(year, month, day_of_month)  # noqa: DTZ001 - differences only
        return day + dt.timedelta(hours=int(clock[0]), minutes=int(clock[1]), seconds=float(clock[2]))
    except (ValueError, IndexError, OverflowError):
        what = f"Date and Time are {segment.cells('Date', place)!r} and {segment.cells('Time', place)!r}"
        raise BadInput(what, f"{where}, header above line {segment.first}", "such as 2026/05/01 and 12:03:04.125") from None


def _remarks(file: _File, channels: Sequence[int]) -> Iterator[str]:
    decimal = "comma" if file.layout.decimal == "," else "point"
    many = f", {len(file.segments)} segments joined by their times" if len(file.segments) > 1 else ""
    yield f"read as a LabVIEW measurement file, decimal {decimal}, X_Columns {file.x_columns.title()}{many}"
    if file.x_columns == "no":
        first = file.segments[0]
        steps = {first.cells("Delta_X", place, "1").replace(",", ".") for place in channels if _has_samples(first, place)}
        shown = " and ".join(f"{float(step):g} s ({1.0 / float(step):.6g} Hz)" for step in sorted(steps) if float(step) != 0.0)
        yield f"times are counted from Delta_X of {shown}"
        stated = first.cells("Samples", channels[0])
        if len(first.lines) > _count(stated) > 0:
            yield f"rows behind the {stated} of the header are taken to go on at its rate"
