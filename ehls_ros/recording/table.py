"""Conversion of named columns of any file format to a trajectory, by the data contract."""

import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.columns import TIME, Column, Columns, element_of, is_contract_name
from ehls_ros.recording.expression import expression
from ehls_ros.recording.time_axis import time_axis
from ehls_ros.trajectory import AS_RIGS_GIVE, MEASURED, Preparation, Trajectory

Pick = Callable[[Sequence[str]], Sequence[str]]
"""Function that returns the names of the columns to read from those available."""


class RawTable(NamedTuple):
    """Table as read from its file.

    Attributes:
        names: names of all columns, in order.
        values: values of the columns read, by name, with times in seconds; None for a non-numeric column.
        row: term for a row, such as ``line``.
        first: number of the first row.
        units: units by name, as written, if stated separately from the name.
        remarks: remarks on the reading of the file, one sentence each.
        wrong: a non-numeric cell of a column, by name, such as ``line 12 is 'abc'``.
    """

    names: tuple[str, ...]
    values: Mapping[str, NDArray[Any] | None]
    row: str = "row"
    first: int = 1
    units: Mapping[str, str] = {}
    remarks: tuple[str, ...] = ()
    wrong: Mapping[str, str] = {}

    def place(self, index: int) -> str:
        """Return the designation of a row in messages, such as ``line 12``."""
        return f"{self.row} {self.first + index}"


def sources(available: Sequence[str], columns: Columns, where: str) -> list[str]:
    """Return the names of the columns to read; arguments and errors as of :func:`choose`."""
    return list(dict.fromkeys(name for column in choose(available, columns, where).values() for name in column.sources))


def no_names(available: Sequence[str]) -> list[str]:
    """Select no columns."""
    return []


def choose(available: Sequence[str], columns: Columns, where: str) -> dict[str, Column]:
    """Select the columns to read.

    Args:
        available: names of the file's columns.
        columns: the user's map; columns with a name of the contract need no entry.
        where: the file, for errors.

    Returns:
        The columns by contract name: ``time_s`` and at least one signal.

    Raises:
        BadInput: a mapped column, the time or every signal is missing, or a name occurs twice.
    """
    chosen = {name: Column(name) for name in available if is_contract_name(name)} | dict(columns)
    found = ", ".join(available) or "none"
    count = Counter(available)
    for name, source in ((name, source) for name, column in chosen.items() for source in column.sources):
        if source not in count:
            what = f"column '{source}' for {name} is missing (found: {found})"
            raise BadInput(what, where, f"a column of that name{_suggestion(source, available)}")
        if count[source] > 1:
            raise BadInput(f"column '{source}' occurs more than once", where, "one column of that name")
    if TIME not in chosen:
        mapped = f"{TIME}: {{name: ...}} with the column of times in the map, or {TIME}: {{rate: ...}} in Hz"
        expected = mapped if columns else f"a column {TIME}, or {_how_to_map(where)}"
        raise BadInput(f"column {TIME} is missing (found: {found})", where, expected)
    if len(chosen) == 1:
        expected = f"a signal by its name in the data contract, or {_how_to_map(where)}"
        raise BadInput(f"no signal is among the columns {found}", where, expected)
    return chosen


def _suggestion(name: str, names: Sequence[str]) -> str:
    matches = get_close_matches(name, names, n=1)
    return f"; did you mean {matches[0]!r}?" if matches else ""


def _how_to_map(where: str) -> str:
    return f"a map of columns (ehls columns {shlex.quote(where)} --out columns.yaml, then --columns columns.yaml)"


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


def not_numeric(column: Column, name: str, where: str) -> BadInput:
    """Return the error for a column that is not numeric."""
    wanted_for = "" if column.shown == name else f" for {name}"
    return BadInput(f"column '{column.shown}'{wanted_for} is not numeric", where, "a column of real numbers")


def trajectory_of(table: RawTable, columns: Columns, where: str) -> Trajectory:
    """Build a trajectory from a table.

    Args:
        table: table with the columns named by :func:`sources`.
        columns: the user's map.
        where: the file, for errors.

    Returns:
        The trajectory, without metadata.

    Raises:
        BadInput: a column is not numeric or has another length, or the time axis is wrong.
    """
    chosen = choose(table.names, columns, where)
    lengths = [len(values) for values in table.values.values() if values is not None]
    values = {name: _unscaled(table, column, name, max(lengths, default=0), where) for name, column in chosen.items()}
    trajectory = assemble(values, chosen, where, table.place)
    return replace(trajectory, preparation=Preparation((*table.remarks, *trajectory.preparation.remarks)))


def _unscaled(table: RawTable, column: Column, name: str, rows: int, where: str) -> NDArray[Any]:
    """Return the unscaled values of a column of the map."""
    values = {source: table.values[source] for source in column.sources}
    known = {source: found for source, found in values.items() if found is not None}
    if len(known) < len(values):
        raise not_numeric(column, name, where)
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
    axis = time_axis(time_s, where, row_name, values[TIME].astype(np.float64))
    for name, signal in scaled.items():
        if name in MEASURED or name in AS_RIGS_GIVE:
            _check_finite(signal, name, where, row_name)
        if len(signal) != len(time_s):
            raise BadInput(f"{name} has {len(signal)} values", where, f"{len(time_s)}, as {TIME} has")
    kept = scaled if axis.rows is None else {name: signal[axis.rows] for name, signal in scaled.items()}
    return Trajectory(axis.time, _with_elements_joined(kept, where), preparation=Preparation(axis.remarks))


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
