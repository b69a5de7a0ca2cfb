"""Reading of Excel files with python-calamine: the first non-empty sheet, with names in a row above the values."""

import datetime as dt
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import unique_names
from ehls_ros.recording.contained import check_library, contained, library_errors
from ehls_ros.recording.table import Pick, RawTable, check_length
from ehls_ros.recording.table_layout import header_of, is_number
from ehls_ros.recording.times import seconds_of_moments

LIBRARY = "python_calamine"
"""Module that reads the files."""

EXPECTED_FILE = "an Excel file, or the data as CSV"

LOOKED_AT = 1000
"""Number of first rows that are searched for the names."""


def read_excel(path: Path, pick: Pick | None = None) -> RawTable:
    """Read an Excel file.

    Args:
        path: the file, ``.xlsx`` or ``.xls``; an empty cell is NaN.
        pick: returns the names of the columns to read, whose cells must be numbers, times or empty; None: all columns, where
            one with any other cell becomes None.

    Returns:
        The table.

    Raises:
        BadInput: python-calamine is missing, the file cannot be read, or a cell is wrong.
    """
    check_library(LIBRARY, "python-calamine", path)
    return contained(read_here, path, pick, EXPECTED_FILE, RawTable, [LIBRARY])


def read_here(path: Path, pick: Pick | None) -> RawTable:
    """Read an Excel file in this process, without a memory limit; see :func:`read_excel`."""
    where = str(path)
    with (
        library_errors("an Excel file", where, EXPECTED_FILE),
        import_module(LIBRARY).CalamineWorkbook.from_path(path) as book,
    ):
        sheets = [(name, book.get_sheet_by_name(name)) for name in book.sheet_names]
        name, sheet = next(((name, sheet) for name, sheet in sheets if sheet.height > 1), sheets[0])
        check_length(sheet.height, sheet.width, where)
        rows = sheet.to_python(skip_empty_area=False)
    head = [[_text(cell) for cell in row] if any(cell != "" for cell in row) else [] for row in rows[:LOOKED_AT]]
    header = header_of(head, lambda cell: is_number(cell, "."))
    values = rows[header.first :]
    while values and all(cell == "" for cell in values[-1]):
        values.pop()
    unique = unique_names(header.names)
    wanted = unique if pick is None else pick(header.names)
    columns: dict[str, NDArray[np.float64] | None] = {}
    texts: dict[str, str] = {}
    for column in wanted:
        place = unique.index(column)
        cells = [row[place] for row in values]
        wrong = next((k for k, cell in enumerate(cells) if _seconds(cell) is None), None)
        if wrong is not None:
            cell, row_name = repr(_text(cells[wrong])[:40]), f"row {header.first + wrong + 1}"
            if pick is not None:
                raise BadInput(f"column '{column}' is {cell}", f"{where}, {row_name}", "a number, a time or an empty cell")
            texts[column] = f"{row_name} is {cell}"
        columns[column] = None if wrong is not None else _numbers(cells)
    clocks = {name: "s" for name, kind in zip(unique, header.kinds, strict=True) if kind == "clock"}
    others = [other for other, _ in sheets if other != name]
    remarks = [f"read from sheet '{name}'; not from {', '.join(others)}"] if others else []
    return RawTable(header.names, columns, "row", header.first + 1, {**header.units, **clocks}, tuple(remarks), texts)


def _text(cell: object) -> str:
    return str(cell).strip()


def _seconds(cell: Any) -> float | np.datetime64 | None:
    """Return a cell as a number, a time of day in seconds, or a date; None for any other content."""
    match cell:
        case "":
            return np.nan
        case bool() | int() | float():
            return float(cell)
        case dt.datetime():
            return np.datetime64(cell)
        case dt.timedelta():
            return cell.total_seconds()
        case dt.time():
            return 3600.0 * cell.hour + 60.0 * cell.minute + cell.second + 1e-6 * cell.microsecond
        case _:
            return None


def _numbers(cells: list[Any]) -> NDArray[np.float64]:
    numbers = [_seconds(cell) for cell in cells]
    if any(isinstance(number, np.datetime64) for number in numbers):
        moments = [number if isinstance(number, np.datetime64) else np.datetime64("NaT") for number in numbers]
        return seconds_of_moments(np.array(moments, dtype="datetime64[us]"))
    return np.array(numbers, dtype=np.float64)
