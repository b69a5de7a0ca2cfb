"""Sections of a text file with several tables: blocks of an acquisition with a header each, or results above the raw data.

A section begins with a row of names, directly above its values or above their units, that is set off from the values before by
a blank line or a line of another width. Sections with the same names and units are one table.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.recording.table_layout import SPACES, TAIL, Header, Row, header_of, is_clock, is_number, split

VALUE_BEGINS = frozenset("0123456789+-.,")
"""First characters of lines that are values without a closer look, if their width is that of the section."""

LONGEST_HEADER = 200
"""Maximum number of lines between two sections."""


class Section(NamedTuple):
    """Section of a text file.

    Attributes:
        header: header of the section; its rows are lines, numbered from 0.
        end: index of the line after the last row of values.
    """

    header: Header
    end: int


class Table(NamedTuple):
    """Sections with the same names and units.

    Attributes:
        header: header of the first section.
        ranges: first line, and that after the last one, of the values of each section.
    """

    header: Header
    ranges: tuple[tuple[int, int], ...]

    @property
    def rows(self) -> int:
        """Number of rows of values."""
        return sum(end - begin for begin, end in self.ranges)


def tables_of(sections: Iterable[Section]) -> list[Table]:
    """Join the sections with the same names and units to tables, in the order of their first sections."""
    found: dict[tuple[object, ...], Table] = {}
    for section in sections:
        header = section.header
        key = (header.names, tuple(sorted(header.units.items())))
        before = found.get(key, Table(header, ()))
        found[key] = before._replace(ranges=(*before.ranges, (header.first, section.end)))
    return list(found.values())


def sections_of(lines: Iterable[str], delimiter: str, decimal: str, where: str) -> Iterator[Section]:
    """Find the sections of a text file.

    Args:
        lines: all lines, without their ends.
        delimiter: delimiter of cells.
        decimal: decimal sign.
        where: the file, for errors.

    Yields:
        The sections.

    Raises:
        BadInput: lines among or below the values belong to no header, such as a damaged row.
    """
    number_here = partial(is_number, decimal=decimal)

    def is_values(row: Row) -> bool:
        filled = [cell for cell in row if cell]
        return 2 * sum(number_here(cell) or is_clock(cell) for cell in filled) > len(filled) > 0

    current: Header | None = None
    width, last, begin = 0, -1, 0
    pending: list[Sequence[str]] = []
    for place, line in enumerate(lines):
        plain = current is not None and not pending and line.lstrip(" ")[:1] in VALUE_BEGINS and '"' not in line
        if plain and (len(line.split()) if delimiter == SPACES else line.count(delimiter) + 1) == width:
            last = place
            continue
        row = [cell.strip() for cell in split(line, delimiter)] if line.strip() else []
        same = current is not None and len(row) == width
        values = is_values(row)
        if same and not pending and (values or any(map(number_here, row))):
            last = place
            continue
        header = _header(pending, row, number_here, begin) if values and pending else None
        apart = current is None or any(len(other) != width for other in pending)
        if header is not None and (apart or (current is not None and header.names == current.names)):
            if current is not None:
                yield Section(current, last + 1)
            current, width, last, pending = header, len(row), place, []
            begin = place + 1
            continue
        if current is not None and values and (same or not pending):
            # A row of another width among values, or values below lines that are no header.
            raise _wrong((pending or [row])[0], begin if pending else place, width, where)
        if not pending:
            begin = place
        pending.append(row)
        if len(pending) > LONGEST_HEADER:
            if current is not None:
                break
            pending, begin = pending[1:], begin + 1
    if current is not None:
        if any(map(any, pending)):
            raise _wrong(pending[0], begin, width, where)
        yield Section(current, last + 1)


def _wrong(row: Row, place: int, width: int, where: str) -> BadInput:
    what = f"the row has {len(row)} cells"
    return BadInput(what, f"{where}, line {place + 1}", f"{width}, as in the header; or no such line")


def _header(pending: Sequence[Row], row: Row, number_here: Callable[[str], bool], begin: int) -> Header | None:
    """Return the header directly above a row of values, with line numbers; None if there is none."""
    # More rows of values than lines above, so that the row determines the width.
    found = header_of([*pending, *[row] * (2 * len(pending) + TAIL)], number_here)
    if found.row is None or len(found.names) != len(row) or found.first != len(pending):
        return None
    units_row = None if found.units_row is None else found.units_row + begin
    return found._replace(row=found.row + begin, units_row=units_row, first=found.first + begin)
