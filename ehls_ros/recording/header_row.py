"""Search for the names of a table's columns in its first rows: below keys and comments, above or below a row of units."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple, TypeVar

from ehls_ros.recording.units import unit_of

COMMENT = re.compile(r"\s*[#%]+\s*")
"""Beginning of a comment row."""

CLOCK = re.compile(r"(?:(?:\d{4}-\d\d-\d\d|\d{1,2}\.\d{1,2}\.\d{4})(?:[T ]|\Z))?(?:\d{1,2}:\d\d:\d\d(?:[.,]\d+)?Z?)?")
"""A date, a time of day or both."""

TAIL = 30
"""Number of last rows from which the format of a table's rows is determined."""

NO_UNIT = ("", "-", "1", "–")
"""Cells that denote a missing unit in a row of units."""

Item = TypeVar("Item")
Row = Sequence[str]

Kind = Literal["number", "clock", "text"]
"""Kind of the cells of a column."""


class Header(NamedTuple):
    """Positions of the parts of a table.

    Attributes:
        names: column names; ``column 1`` and so on without a row of names.
        units: units by name, as written in a row of units.
        row: index of the row of names; None without one.
        units_row: index of the row of units; None without one.
        first: index of the first row of values.
        kinds: kinds of the columns' values, as far as examined.
    """

    names: tuple[str, ...]
    units: Mapping[str, str]
    row: int | None
    units_row: int | None
    first: int
    kinds: tuple[Kind, ...]


def is_clock(cell: str) -> bool:
    """Return whether a cell is a date, a time of day or both."""
    return bool(cell) and CLOCK.fullmatch(cell) is not None


def tail_of(items: Sequence[Item]) -> Sequence[Item]:
    """Return the last rows, which are rows of values if there are any; for few rows, the last half, but at least two."""
    return items[max(0, min(len(items) // 2, len(items) - 2)) :][-TAIL:]


def header_of(rows: Sequence[Row], is_number: Callable[[str], bool]) -> Header:
    """Find the names and units of a table.

    Args:
        rows: its first rows, stripped cells; an empty one for a blank line, and the hash or percent sign of a comment in its
            first cell.
        is_number: returns whether a cell is a number.

    Returns:
        The header. A damaged row of values is not taken for names.
    """

    def told(cell: str) -> bool:
        return is_number(cell) or is_clock(cell)

    plain = [k for k, row in enumerate(rows) if any(row) and not COMMENT.match(row[0])]
    last = tail_of(plain)
    counts = [len(rows[k]) for k in last]
    width = max(counts, key=lambda count: (counts.count(count), count), default=0)
    tail = [rows[k] for k in last if len(rows[k]) == width]
    kinds: list[Kind] = [_kind(list(filter(None, cells)), is_number) for cells in zip(*tail, strict=True)]

    def is_values(row: Row) -> bool:
        cells = [cell for cell, kind in zip(row, kinds, strict=False) if kind != "text"]
        filled = [cell for cell in cells if cell]
        return len(row) == width and 2 * sum(map(told, filled)) > len(filled) > 0

    first = next((k for k in plain if is_values(rows[k])), None)
    if first is None:
        # Without values, the last row of this width can only be names.
        first = max((k + 1 for k in plain if len(rows[k]) == width), default=0)
    above = [k for k in plain if k < first]
    while above and len(rows[above[-1]]) == width and any(map(told, rows[above[-1]])):
        first = above.pop()  # a damaged row of values
    if not above or len(rows[above[-1]]) != width:
        commented = [k for k in range(first) if rows[k] and k not in plain and len(rows[k]) in (width, width + 1)]
        above = commented or above
    named, units_row = _named([k for k in above[-3:] if not any(map(told, _uncommented(rows[k])))], rows)
    names = _uncommented(rows[named]) if named is not None else [f"column {k + 1}" for k in range(width)]
    if len(names) == width - 1 and kinds[-1] == "text":
        names.append("")  # each row of values ends with a delimiter
    kinds = (kinds + ["text"] * len(names))[: len(names)]
    written = _uncommented(rows[units_row]) if units_row is not None else []
    units = {name: unit.strip("[](){}<> ") for name, unit in zip(names, written, strict=False) if unit not in NO_UNIT}
    return Header(tuple(names), units, named, units_row, first, tuple(kinds))


def _named(texts: Sequence[int], rows: Sequence[Row]) -> tuple[int | None, int | None]:
    """Return the indices of the row of names and of the row of units among the last rows of text above the values."""
    alike = [k for k in texts if len(rows[k]) == len(rows[texts[-1]])]
    units_row = next((k for k in alike[-2:] if len(alike) > 1 and _are_units(_uncommented(rows[k]))), None)
    if units_row is not None and units_row - 1 in alike:
        return units_row - 1, units_row  # a row below the units holds a comment for each channel
    return next((k for k in reversed(texts) if k != units_row), None), units_row


def _kind(cells: Sequence[str], is_number: Callable[[str], bool]) -> Kind:
    numbers, clocks = sum(map(is_number, cells)), sum(map(is_clock, cells))
    if 2 * (numbers + clocks) < max(1, len(cells)):
        return "text"
    return "number" if numbers >= clocks else "clock"


def _uncommented(row: Row) -> list[str]:
    """Return the cells of a row without the comment sign."""
    if not row or not COMMENT.match(row[0]):
        return list(row)
    head = COMMENT.sub("", row[0], count=1)
    return [head, *row[1:]] if head else list(row[1:])


def _are_units(row: Row) -> bool:
    said = [cell for cell in row if cell not in NO_UNIT]
    return bool(said) and all(unit_of(cell.strip("[](){}<> ")) is not None for cell in said)
