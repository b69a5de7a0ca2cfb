"""Conversion of named columns of any file format to a trajectory, by the data contract."""

import shlex
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.columns import (
    TIME,
    Column,
    Columns,
    element_of,
    is_contract_name,
    numbered,
    place_of,
    unique_name,
    unit_of,
)
from ehls_ros.recording.expression import expression
from ehls_ros.recording.time_axis import copied_rows, time_axis
from ehls_ros.trajectory import AS_RIGS_GIVE, MEASURED, OF_CHAMBERS, Preparation, Trajectory
from ehls_ros.units import UNITS

NONE: Mapping[str, str] = MappingProxyType({})

TIMES_IN_SECONDS = f"taken as times in s; {TIME} in the map, with the name of one and its unit, states another"
"""Remark on time columns without a unit, of several in a file: a map can name one of them, and with it the unit of all."""


class Pick(Protocol):
    """Function that returns the names of the columns to read."""

    def __call__(self, available: Sequence[str], time_of: Mapping[str, str] = NONE, /) -> Sequence[str]:
        """Return the names of the columns to read.

        Args:
            available: names of the file's columns.
            time_of: name of the time column of each column, if the file states it; the result includes those needed.
        """


class RawTable(NamedTuple):
    """Table as read from its file.

    Attributes:
        names: names of all columns, in order.
        values: values of the columns read, with times in seconds; None for a non-numeric column. By name; a column whose name
            is empty or occurs more than once by its number, such as ``column 3``, here and in the mappings below.
        row: term for a row, such as ``line``.
        first: number of the first row.
        units: units by name, as written, if stated separately from the name.
        remarks: remarks on the reading of the file, one sentence each.
        wrong: a non-numeric cell of a column, by name, such as ``line 12 is 'abc'``.
        time_of: name of the time column of each column, if the file states it; those columns have no entry. Empty: one axis
            for all, which the map or the data contract names.
        blocks: index and number of the first row of each further block of rows, if they do not follow each other in the file.
    """

    names: tuple[str, ...]
    values: Mapping[str, NDArray[Any] | None]
    row: str = "row"
    first: int = 1
    units: Mapping[str, str] = {}
    remarks: tuple[str, ...] = ()
    wrong: Mapping[str, str] = {}
    time_of: Mapping[str, str] = {}
    blocks: tuple[tuple[int, int], ...] = ()

    def place(self, index: int) -> str:
        """Return the designation of a row in messages, such as ``line 12``."""
        begin, first = max(((begin, first) for begin, first in self.blocks if begin <= index), default=(0, self.first))
        return f"{self.row} {first + index - begin}"

    def column(self, name: str) -> NDArray[Any] | None:
        """Return the values of a column by its name or number."""
        return self.values[unique_name(name, self.names)]


def sources(
    available: Sequence[str], time_of: Mapping[str, str] = NONE, *, columns: Columns = MappingProxyType({}), where: str = ""
) -> list[str]:
    """Return the names of the columns to read, with their time columns; arguments and errors as of :func:`choose`."""
    chosen = choose(available, columns, where, time_of).values()
    names = [unique_name(name, available) for column in chosen for name in column.sources]
    return list(dict.fromkeys([*names, *(time_of[name] for name in names if name in time_of)]))


def no_names(available: Sequence[str], time_of: Mapping[str, str] = NONE, /) -> list[str]:
    """Select no columns."""
    return []


def choose(available: Sequence[str], columns: Columns, where: str, time_of: Mapping[str, str] = NONE) -> dict[str, Column]:
    """Select the columns to read.

    Args:
        available: names of the file's columns.
        columns: the user's map; columns with a name of the contract need no entry.
        where: the file, for errors.
        time_of: name of the time column of each column, if the file states it.

    Returns:
        The columns by contract name: at least one signal, and ``time_s`` unless the file states the times of all signals.

    Raises:
        BadInput: a mapped column, the time or every signal is missing, or a name occurs twice.
    """
    chosen = {name: Column(name) for name in available if is_contract_name(name)} | dict(columns)
    found = ", ".join(available) or "none"
    count = Counter(available)
    for name, source in ((name, source) for name, column in chosen.items() for source in column.sources):
        if place_of(source, available) is None:
            what = f"column '{source}' for {name} is missing (found: {found})"
            expected = f"a column of that name{_suggestion(source, available)}; or a number, as 'column 3' of {len(available)}"
            raise BadInput(what, where, expected)
        if count[source] > 1:
            numbers = " or ".join(f"'{numbered(place)}'" for place, other in enumerate(available) if other == source)
            raise BadInput(f"column '{source}' occurs more than once", where, f"one column of that name; or name: {numbers}")
    untimed = [column.shown for column in chosen.values() if not any(_axes(column, available, time_of))]
    if TIME not in chosen and time_of and untimed:
        expected = (
            f"{TIME}: {{name: ...}} with a column of times, or {TIME}: {{rate: ...}} in Hz, in the map, for all its columns"
        )
        raise BadInput(f"column '{untimed[0]}' has no times in the file", where, expected)
    if TIME not in chosen and not time_of:
        mapped = f"{TIME}: {{name: ...}} with the column of times in the map, or {TIME}: {{rate: ...}} in Hz"
        expected = mapped if columns else f"a column {TIME}, or {_how_to_map(where)}"
        raise BadInput(f"column {TIME} is missing (found: {found})", where, expected)
    if chosen.keys() <= {TIME}:
        expected = f"a signal by its name in the data contract, or {_how_to_map(where)}"
        raise BadInput(f"no signal is among the columns {found}", where, expected)
    return chosen


def _axes(column: Column, names: Sequence[str], time_of: Mapping[str, str]) -> list[str]:
    """Return the time columns of the sources of a column, as far as the file states them."""
    sources = [unique_name(source, names) for source in column.sources]
    return [time_of[source] for source in sources if source in time_of]


def _suggestion(name: str, names: Sequence[str]) -> str:
    matches = get_close_matches(name, names, n=1)
    return f"; did you mean {matches[0]!r}?" if matches else ""


def _how_to_map(where: str) -> str:
    return f"a map of columns (ehls columns {shlex.quote(where)} --out columns.yaml, then --columns columns.yaml)"


def unused(name: str, taken: Collection[str]) -> str:
    """Return a name for a further column: the given one, or with the first number from 2 on that makes it unique."""
    return next(free for free in (name, *(f"{name} {k}" for k in range(2, len(taken) + 3))) if free not in taken)


def check_length(rows: int, columns: int, where: str) -> None:
    """Reject a table that is too long.

    Args:
        rows: number of rows.
        columns: number of columns to read.
        where: the file, for the error.

    Raises:
        BadInput: the table is too long.
    """
    if rows > limits.ROWS or rows * columns > limits.VALUES:
        expected = f"at most {limits.ROWS} rows and {limits.VALUES} values; split a longer recording into several files"
        raise BadInput(f"it has at least {rows} rows in {columns} columns to read", where, expected)


def not_numeric(column: Column, name: str, where: str, reason: str = "") -> BadInput:
    """Return the error for a column that is not numeric."""
    wanted_for = "" if column.shown == name else f" for {name}"
    shown = f" ({reason})" if reason else ""
    return BadInput(f"column '{column.shown}'{wanted_for} is not numeric{shown}", where, "a column of real numbers")


def trajectories_of(table: RawTable, columns: Columns, where: str) -> dict[str, Trajectory]:
    """Build the trajectories of a table: one for each of its time axes.

    Args:
        table: table with the columns named by :func:`sources`.
        columns: the user's map. If its ``time_s`` is one of several time axes, its offset is that of all, and its unit that of
            those without one. If it is another column, or a rate, it replaces the times of the file.
        where: the file, for errors.

    Returns:
        The trajectories by the names of their time columns, without metadata.

    Raises:
        BadInput: a column is not numeric or has another length, or the time axis is wrong.
    """
    chosen = choose(table.names, columns, where, table.time_of)
    axes = _by_axis(table, chosen, where)
    remarks = [*table.remarks, *_replaced(table, chosen, axes, where)]
    out: dict[str, Trajectory] = {}
    for axis, group in axes.items():
        read = [table.column(source) for column in group.values() for source in column.sources]
        rows = max((len(values) for values in read if values is not None), default=0)
        values = {name: _unscaled(table, column, name, rows, where) for name, column in group.items()}
        trajectory = assemble(values, group, where, table.place)
        preparation = Preparation((*(remarks if not out else ()), *trajectory.preparation.remarks))
        out[axis] = replace(trajectory, preparation=preparation)
    return out


def _by_axis(table: RawTable, chosen: Columns, where: str) -> dict[str, dict[str, Column]]:
    """Group the chosen columns by time axis, each with its time column."""
    time = chosen.get(TIME)
    if time is not None and time.name not in table.time_of.values():
        return {time.name: dict(chosen)}
    out: dict[str, dict[str, Column]] = {}
    same = _equal_axes(table, "" if time is None else time.name)
    for name, column in chosen.items():
        if name == TIME:
            continue
        axes = {same[axis] for axis in _axes(column, table.names, table.time_of)}
        if len(axes) > 1:
            what = f"the columns of {column.shown} for {name} have different times ({', '.join(sorted(axes))})"
            raise BadInput(what, where, "columns of one time axis, or a signal for each")
        axis = axes.pop() if axes else chosen[TIME].name
        unit = unit_of(table.units.get(axis, ""))
        if time is None:
            own = Column(axis, UNITS[unit or "s"].scale)
        else:
            own = Column(axis, UNITS[unit].scale, time.offset) if unit and axis != time.name else time._replace(name=axis)
        out.setdefault(axis, {TIME: own})[name] = column
    return out


def _equal_axes(table: RawTable, named: str) -> dict[str, str]:
    """Return the first of the time columns with the same times, by time column; the one that the map names comes first."""
    out: dict[str, str] = {}
    known: dict[str, NDArray[Any]] = {}
    for axis in sorted(dict.fromkeys(table.time_of.values()), key=lambda axis: axis != named):
        times, unit = table.values.get(axis), table.units.get(axis)
        others = (other for other in known if table.units.get(other) == unit)
        out[axis] = axis if times is None else next((other for other in others if np.array_equal(known[other], times)), axis)
        if times is not None:
            known.setdefault(out[axis], times)
    return out


def _replaced(table: RawTable, chosen: Columns, used: Mapping[str, object], where: str) -> list[str]:
    """Return a remark if the map replaces several time axes of the file by one; reject axes of different lengths."""
    named = [axis for name, column in chosen.items() if name != TIME for axis in _axes(column, table.names, table.time_of)]
    axes = {axis: table.values.get(axis) for axis in named}
    known = {axis: times for axis, times in axes.items() if times is not None and len(times)}
    if axes.keys() & used.keys() or len(known) < 2:
        return []
    shown = ", ".join(f"{axis}: {len(t)} rows, {t[0]:.6g} to {t[-1]:.6g}" for axis, t in known.items())
    if len(set(map(len, known.values()))) > 1:
        what = f"{TIME} of the map is one axis, and the file has several ({shown})"
        raise BadInput(what, where, f"no {TIME} in the map, as the file has the times of each column")
    return [f"{TIME} of the map replaces the times of the file ({shown})"]


def _unscaled(table: RawTable, column: Column, name: str, rows: int, where: str) -> NDArray[Any]:
    """Return the unscaled values of a column of the map."""
    values = {source: table.column(source) for source in column.sources}
    known = {source: found for source, found in values.items() if found is not None}
    if len(known) < len(values):
        raise not_numeric(column, name, where, next((table.wrong[s] for s in column.sources if s in table.wrong), ""))
    if not values:
        return np.arange(rows, dtype=np.float64)
    if not column.expression:
        return known[column.name]
    if any(found.dtype.kind not in "fiub" or found.ndim != 1 for found in known.values()):
        raise not_numeric(column, name, where)
    if len(shapes := {len(found) for found in known.values()}) > 1:
        raise BadInput(f"the columns of {column.expression} for {name} have {shapes} values", where, "columns of one length")
    return expression(column.expression).of(known)


def assemble(values: Mapping[str, NDArray[Any]], chosen: Columns, where: str, row_name: Callable[[int], str]) -> Trajectory:
    """Build a trajectory from columns.

    Args:
        values: raw values by contract name: shape (n,), or (n, elements) for a signal of the friction elements.
        chosen: the columns by contract name, with scale and offset.
        where: the file, for errors.
        row_name: returns the designation in messages of the row at an index, such as ``line 12``.

    Returns:
        The trajectory, without metadata, with remarks on repairs of its time axis and on gaps.

    Raises:
        BadInput: a column is not numeric or has another length, or the time axis is wrong.
    """
    check_length(max(map(len, values.values())), len(chosen), where)
    scaled = {name: _scaled(values[name], column, name, where) for name, column in chosen.items()}
    time_s = scaled.pop(TIME)
    for name, signal in scaled.items():
        if name in MEASURED or name in OF_CHAMBERS or name in AS_RIGS_GIVE:
            _check_finite(signal, name, where, row_name)
        if len(signal) != len(time_s):
            raise BadInput(f"{name} has {len(signal)} values", where, f"{len(time_s)}, as {TIME} has")
    kept, remarks = np.arange(len(time_s)), list[str]()
    copies = copied_rows(time_s, scaled)
    if copies is not None:
        kept = np.flatnonzero(~copies)
        remarks.append(f"{len(time_s) - len(kept)} rows that repeat the row before are left out")
    axis = time_axis(time_s[kept], where, lambda row: row_name(int(kept[row])), values[TIME].astype(np.float64)[kept])
    kept = kept if axis.rows is None else kept[axis.rows]
    if len(kept) < len(time_s):
        scaled = {name: signal[kept] for name, signal in scaled.items()}
    return Trajectory(axis.time, _with_elements_joined(scaled, where), preparation=Preparation((*remarks, *axis.remarks)))


def _scaled(values: NDArray[Any], column: Column, name: str, where: str) -> NDArray[np.float64]:
    if values.dtype.kind not in "fiub":
        raise not_numeric(column, name, where)
    if values.ndim != 1 and not (values.ndim == 2 and element_of(f"{name}_1")):
        raise BadInput(f"column '{column.shown}' for {name} has the shape {values.shape}", where, "one value per sample")
    numbers = values.astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        if column.scale != 1:
            numbers *= column.scale
        if column.offset != 0:
            numbers += column.offset
    return numbers


def _check_finite(signal: NDArray[np.float64], name: str, where: str, row_name: Callable[[int], str]) -> None:
    infinite = np.flatnonzero(np.isinf(signal))
    if len(infinite):
        place = f"{where}, {row_name(int(infinite[0]))}"
        raise BadInput(f"{name} is {signal[infinite[0]]}", place, "a finite number, or an empty cell")


def _with_elements_joined(signals: Mapping[str, NDArray[np.float64]], where: str) -> dict[str, NDArray[np.float64]]:
    """Join the columns of the friction elements to arrays of shape (n, elements)."""
    joined: dict[str, NDArray[np.float64]] = {}
    elements: dict[str, dict[int, NDArray[np.float64]]] = {}
    for name, values in signals.items():
        element = element_of(name)
        if element is None:
            joined[name] = values
        else:
            elements.setdefault(element[0], {})[element[1]] = values
    for signal, by_number in elements.items():
        if signal in joined or set(by_number) != set(range(1, len(by_number) + 1)):
            numbers = ", ".join(str(number) for number in sorted(by_number))
            raise BadInput(f"{signal} has columns {numbers}", where, "one column per element, numbered from 1")
        joined[signal] = np.column_stack([by_number[number] for number in sorted(by_number)])
    return joined
