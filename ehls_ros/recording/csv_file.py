"""CSV files in the format of the data contract: a header row of signal names, values in SI units."""

import csv
import math
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain, count, islice
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.columns import TIME, Column, Columns
from ehls_ros.recording.deadline import Deadline
from ehls_ros.recording.reason import reason
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.recording.table import RawTable, assemble, check_length, choose
from ehls_ros.trajectory import Trajectory

DELIMITERS = ",;\t"
BLOCK = 16384
"""Rows written together, and read between two checks of the limits."""

LOOKED_AT = 200_000
"""Rows that tell what a column holds."""


def read_csv(path: Path, columns: Columns = MappingProxyType({})) -> Trajectory:
    """Read a CSV file.

    Columns whose name is not in the data contract are ignored unless mapped. An empty cell is NaN.

    Args:
        path: the file, UTF-8, with a header row; separated by commas, semicolons or tabs.
        columns: the user's own names and units.

    Returns:
        The trajectory, without metadata.

    Raises:
        BadInput: the file cannot be read, a column or cell is wrong, or time does not increase with every row.
    """
    where = str(path)
    with _opened(path) as (stream, deadline):
        chosen, values = _read(stream, columns, deadline, where)
    return assemble(values, chosen, where, _line)


def csv_names(path: Path) -> list[str]:
    """Return the names of a CSV file's columns.

    Raises:
        BadInput: the file cannot be read.
    """
    with _opened(path) as (stream, _):
        return _rows(stream, str(path))[1]


def raw_csv(path: Path) -> RawTable:
    """Return the first :data:`LOOKED_AT` rows of all columns of a CSV file by their names; None for one that is not of numbers.

    Raises:
        BadInput: the file cannot be read.
    """
    where = str(path)
    with _opened(path) as (stream, deadline):
        rows, header = _rows(stream, where)
        table = [row for row in islice(rows, LOOKED_AT) if len(row) == len(header)]
        deadline.check()
    cells = zip(*table, strict=True) if table else iter([()] * len(header))
    return {name: _column_of(column) for name, column in zip(header, cells, strict=True)}


def _column_of(cells: Sequence[str]) -> NDArray[np.float64] | None:
    try:
        values = np.array([float(cell) if cell.strip() else math.nan for cell in cells], dtype=np.float64)
    except ValueError:
        return None
    return values if np.any(np.isfinite(values)) else None


@contextmanager
def _opened(path: Path) -> Iterator[tuple[TextIO, Deadline]]:
    where = str(path)
    deadline = Deadline(check_regular(path, limits.TABLE, "a CSV file", larger=limits.TABLE_LARGER), where)
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            yield stream, deadline
    except OSError as error:
        raise BadInput(f"the file cannot be read ({reason(error)})", where, "a CSV file") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"it is not CSV ({reason(error)})", where, "a CSV file in UTF-8") from None


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """Write a CSV file from which :func:`read_csv` restores every value exactly.

    Signals of the friction elements become one column each, such as ``friction_elements_n_1``. Metadata are not written.

    Args:
        path: the file; an existing one is replaced.
        trajectory: to be written.

    Raises:
        BadInput: the file cannot be created.
        OSError: the disk is full or fails.
    """
    columns = dict(_columns(trajectory))
    try:
        stream = path.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise BadInput(f"the output cannot be created ({reason(error)})", str(path), "a writable file") from None
    with stream:
        stream.write(",".join(columns) + "\n")
        for start in range(0, len(trajectory), BLOCK):
            block = np.column_stack([column[start : start + BLOCK] for column in columns.values()])
            stream.writelines(",".join(map(repr, row)) + "\n" for row in block.tolist())


def _columns(trajectory: Trajectory) -> Iterator[tuple[str, NDArray[np.float64]]]:
    yield TIME, trajectory.time_s
    for name, values in trajectory.signals.items():
        if values.ndim == 1:
            yield name, values
        else:
            yield from ((f"{name}_{number}", column) for number, column in enumerate(values.T, start=1))


def _read(
    stream: TextIO, columns: Columns, deadline: Deadline, where: str
) -> tuple[dict[str, Column], dict[str, NDArray[np.float64]]]:
    """Return the chosen columns and their values by contract name."""
    rows, header = _rows(stream, where)
    chosen = choose(header, columns, where)
    places = {name: place for place, name in enumerate(header)}
    pick = itemgetter(*(places[column.name] for column in chosen.values()))
    numbers = array("d")
    for number, row in enumerate(rows):
        if number % BLOCK == 0:
            deadline.check()
            check_length(number, len(chosen), where)
        if len(row) != len(header):
            if not row and _only_space_in(stream):
                break
            line = f"{where}, {_line(len(numbers) // len(chosen))}"
            raise BadInput(f"the row has {len(row)} cells", line, f"{len(header)}, as in the header")
        cells = pick(row)
        try:
            values = list(map(float, cells))
        except ValueError:
            values = []
        if not values or "_" in "".join(cells):
            line = f"{where}, {_line(len(numbers) // len(chosen))}"
            values = [_number(cell, column, line) for cell, column in zip(cells, chosen.values(), strict=True)]
        numbers.extend(values)
    table = np.frombuffer(numbers).reshape(-1, len(chosen))
    return chosen, dict(zip(chosen, table.T, strict=True))


def _rows(stream: TextIO, where: str) -> tuple[Iterator[list[str]], list[str]]:
    """Return the rows of values, and the names in the header."""
    lines = _lines(stream, where)
    first_line = next(lines, "")
    delimiter = max(DELIMITERS, key=first_line.count)
    rows = csv.reader(chain([first_line], lines), delimiter=delimiter, skipinitialspace=True, strict=True)
    return rows, [name.strip() for name in next(rows, [])]


def _lines(stream: TextIO, where: str) -> Iterator[str]:
    """Yield the lines; a longer one is refused without reading all of it."""
    for number in count(1):
        line = stream.readline(limits.LINE + 1)
        if len(line) > limits.LINE:
            expected = f"a CSV file with one line per sample, of at most {limits.LINE}"
            raise BadInput(f"the line has more than {limits.LINE} characters", f"{where}, line {number}", expected)
        if not line:
            return
        yield line


def _only_space_in(stream: TextIO) -> bool:
    """Tell whether the rest of a file is white space."""
    return not any(piece.strip() for piece in iter(partial(stream.read, limits.LINE), ""))


def _number(cell: str, column: Column, where: str) -> float:
    if not cell.strip():
        return math.nan
    # Python accepts 1_000 as a number; no data export means that.
    with suppress(ValueError):
        if "_" not in cell:
            return float(cell)
    raise BadInput(f"column '{column.name}' is {cell[:40]!r}", where, "a number")


def _line(row: int) -> str:
    """Return the line number of a row of values in an editor, with the header on line 1."""
    return f"line {row + 2}"
