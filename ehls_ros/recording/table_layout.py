"""Layout of a table: encoding, delimiter and decimal sign of a text file, and the rows of names, units and first values.

Above the names there may be keys and comments; a row of units may be above or below them.
"""

import codecs
import csv
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

from ehls_ros.recording.columns import unique_names, unit_of
from ehls_ros.recording.times import CLOCK

COMMENT = re.compile(r"\s*[#%]+\s*")
"""Beginning of a comment row."""

TAIL = 30
"""Number of last rows from which the format of a table's rows is determined."""

NO_UNIT = ("", "-", "--", "1", "–", "unit", "units", "einheit", "einheiten", "n/a", "none", "ohne")
"""Cells that denote a missing unit in a row of units, or label that row, in lower case."""

OTHER_UNITS = (
    *("cycle", "cycles", "segment", "segments", "zyklen", "lw", "strain", "dehnung", "samples", "sample", "ticks", "pulses"),
    *("bit", "bits", "raw", "bool", "db", "w", "kw", "j", "kj", "ohm", "Ω", "hz/s", "l/h", "m^3/h", "kg/s", "1/s", "mm^2/s"),
)
"""Words of a row of units without a quantity in this package, in lower case; they only show that the row is one of units."""

Item = TypeVar("Item")
Row = Sequence[str]

Kind = Literal["number", "clock", "text"]
"""Kind of the cells of a column."""


class Header(NamedTuple):
    """Positions of the parts of a table.

    Attributes:
        names: column names; ``column 1`` and so on without a row of names.
        units: units as written in a row of units, by name, or by number where a name is empty or occurs more than once.
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
    return CLOCK.match(cell) is not None


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

    def is_value(cell: str) -> bool:
        return is_number(cell) or is_clock(cell)

    plain = [k for k, row in enumerate(rows) if any(row) and not COMMENT.match(row[0])]
    last = tail_of(plain)
    counts = [len(rows[k]) for k in last]
    width = max(counts, key=lambda count: (counts.count(count), count), default=0)
    tail = [rows[k] for k in last if len(rows[k]) == width]
    kinds = kinds_of(tail, is_number)

    def is_values(row: Row) -> bool:
        cells = [cell for cell, kind in zip(row, kinds, strict=False) if kind != "text"]
        filled = [cell for cell in cells if cell]
        return len(row) == width and 2 * sum(map(is_value, filled)) > len(filled) > 0

    first = next((k for k in plain if is_values(rows[k])), None)
    if first is None:
        # Without values, the last row of this width can only be names.
        first = max((k + 1 for k in plain if len(rows[k]) == width), default=0)
    above = [k for k in plain if k < first]
    while (
        above and len(rows[above[-1]]) == width and any(map(is_value, rows[above[-1]])) and _known_units(rows[above[-1]]) < 1.0
    ):
        first = above.pop()  # a damaged row of values
    if above and 1 < len(rows[above[-1]]) < width and _known_units(rows[above[-1]]) == 1.0:
        # Delimiters after the last unit are left out.
        rows = [*rows]
        rows[above[-1]] = [*rows[above[-1]], *[""] * (width - len(rows[above[-1]]))]
    if not above or len(rows[above[-1]]) != width:
        commented = [k for k in range(first) if rows[k] and k not in plain and len(rows[k]) in (width, width + 1)]
        above = commented or above
    texts = [
        k for k in above[-3:] if not any(map(is_value, _uncommented(rows[k]))) or _known_units(_uncommented(rows[k])) == 1.0
    ]
    named, units_row = _named(texts, rows)
    names = _uncommented(rows[named]) if named is not None else [f"column {k + 1}" for k in range(width)]
    if len(names) == width - 1 and kinds[-1] == "text":
        names.append("")  # each row of values ends with a delimiter
    kinds = (kinds + ["text"] * len(names))[: len(names)]
    written = _uncommented(rows[units_row]) if units_row is not None else []
    unique = unique_names(names)
    units = {name: unit for name, unit in zip(unique, map(_bare, written), strict=False) if unit.lower() not in NO_UNIT}
    return Header(tuple(names), units, named, units_row, first, tuple(kinds))


def _named(texts: Sequence[int], rows: Sequence[Row]) -> tuple[int | None, int | None]:
    """Return the indices of the row of names and of the row of units among the last rows of text above the values."""
    same_width = [k for k in texts if len(rows[k]) == len(rows[texts[-1]])]
    known = {k: _known_units(_uncommented(rows[k])) for k in same_width}
    # Of equal ones, the lower row: units usually are below the names.
    most = max(same_width, key=lambda k: (known[k], k), default=None)
    units_row = most if most is not None and len(same_width) > 1 and known[most] > 0.0 else None
    if units_row is not None and units_row - 1 in same_width:
        return units_row - 1, units_row  # a row below the units holds a comment for each channel
    return next((k for k in reversed(texts) if k != units_row), None), units_row


def kinds_of(rows: Sequence[Row], is_number: Callable[[str], bool]) -> list[Kind]:
    """Return the kinds of the columns of rows of values of one width."""
    return [_kind(list(filter(None, cells)), is_number) for cells in zip(*rows, strict=True)]


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


def _bare(cell: str) -> str:
    """Return a cell of a row of units without brackets."""
    return cell.strip("[](){}<> ")


def _in_brackets(cell: str) -> bool:
    return (cell[:1], cell[-1:]) in (("[", "]"), ("(", ")"), ("<", ">"), ("{", "}"))


def _known_units(row: Row) -> float:
    """Return the share of known units among the cells of a row that state one; 0 if they are fewer than half."""
    stated = [cell for cell in row if _bare(cell).lower() not in NO_UNIT]
    known = [unit_of(_bare(cell)) is not None or _bare(cell).lower() in OTHER_UNITS or _in_brackets(cell) for cell in stated]
    share = sum(known) / len(stated) if stated else 0.0
    return share if share >= MIN_KNOWN_UNITS else 0.0


MIN_KNOWN_UNITS = 0.5
"""Share of known units from which a row of text is one of units."""


BEGINNING = 2**19
"""Part of a file from which its layout is determined [B]."""

TAIL_CHARACTERS = 2**16
"""Maximum length of text used to find the delimiter [characters]."""

LINES_OF_CELL = 4
"""Maximum number of lines of a quoted name [1]."""

SPACES = r"\s+"
DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", SPACES: "spaces"}
"""Delimiters with their names; of two that fit equally well, the first is chosen."""

MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
"""Encodings by byte order mark."""


class Layout(NamedTuple):
    """The layout of a text file with a table.

    Attributes:
        encoding: Python's name of the encoding.
        delimiter: delimiter of cells; :data:`SPACES` for any white space.
        decimal: point or comma.
        header: header of the table; its rows are lines, numbered from 0.
    """

    encoding: str
    delimiter: str
    decimal: str
    header: Header

    def sentence(self) -> str:
        """Describe the layout in one sentence; empty for the plain layout of the data contract."""
        names = "no line of names" if self.header.row is None else f"names in line {self.header.row + 1}"
        units = "" if self.header.units_row is None else f", units in line {self.header.units_row + 1}"
        point = "comma" if self.decimal == "," else "point"
        layout = (
            f"{self.encoding.removesuffix('-sig')}, {DELIMITERS[self.delimiter]} between cells, decimal {point}, {names}{units}"
        )
        return "" if layout == PLAIN else f"read as {layout}, values from line {self.header.first + 1}"


PLAIN = "utf-8, commas between cells, decimal point, names in line 1"
"""Layout required by the data contract."""


def layout_of(path: Path) -> Layout:
    """Find the layout of a text file from its beginning.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as stream:
        content = stream.read(BEGINNING)
        whole = not stream.read(1)
    encoding = encoding_of(content, whole)
    lines = re.split(r"\r\n|\r|\n", codecs.getincrementaldecoder(encoding)("replace").decode(content))
    if (whole and lines[-1] == "") or (not whole and len(lines) > 1):
        del lines[-1]
    lines = _with_cells_whole(lines)
    plain = [line for line in lines if line.strip() and not COMMENT.match(line)]
    tail, size = list[str](), 0
    for line in reversed(tail_of(plain)):
        size += len(line)
        tail.append(line)
        if size > TAIL_CHARACTERS:
            break
    # With tabs or semicolons as delimiters, spaces are parts of names.
    others = 2 * sum("\t" in line or ";" in line for line in tail) > len(tail)
    delimiters = [delimiter for delimiter in DELIMITERS if not (others and delimiter == SPACES)]
    ranked = [(*_fit(tail, delimiter, decimal), delimiter, decimal) for delimiter in delimiters for decimal in ".,"]
    *_, delimiter, decimal = max(ranked, key=lambda fit: fit[:3])
    rows = [[cell.strip() for cell in split(line, delimiter)] if line.strip() else [] for line in lines]
    return Layout(encoding, delimiter, decimal, header_of(rows, partial(is_number, decimal=decimal)))


def _with_cells_whole(lines: Sequence[str]) -> list[str]:
    """Join quoted cells of a few lines into the line in which they end; the lines before become empty, so the count is kept."""
    out, k = list[str](), 0
    while k < len(lines):
        more = next((n for n in range(LINES_OF_CELL) if " ".join(lines[k : k + n + 1]).count('"') % 2 == 0), 0)
        out += [*[""] * more, " ".join(lines[k : k + more + 1])]
        k += more + 1
    return out


def split(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; a line with an open quote is one cell."""
    if delimiter == SPACES:
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True))
    except csv.Error:
        return [line]


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number with this decimal sign; thousands have no separator."""
    if decimal != ".":
        cell = cell.replace(".", "x").replace(decimal, ".")
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # a separator of digits in Python only


def encoding_of(content: bytes, whole: bool) -> str:
    """Return Python's name of the encoding of a text.

    Args:
        content: beginning of the text.
        whole: whether that is all of it.
    """
    for mark, encoding in MARKS.items():
        if content.startswith(mark):
            return encoding
    # In UTF-16, every second byte of text in Latin letters is zero.
    zeros = [content[k::2].count(0) for k in (0, 1)]
    for other, encoding in ((0, "utf-16-le"), (1, "utf-16-be")):
        if zeros[other] == 0 and zeros[1 - other] > len(content) // 4:
            return encoding
    for encoding in ("utf-8", "cp1252"):
        try:
            codecs.getincrementaldecoder(encoding)().decode(content, final=whole)
        except UnicodeDecodeError:
            continue
        return encoding
    return "latin-1"


def _fit(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[bool, float, int]:
    """Rate a delimiter and a decimal sign: whether there are columns, the share of numbers, and the number of columns."""
    number: Callable[[str], bool] = partial(is_number, decimal=decimal)
    rows = [[cell.strip() for cell in split(line, delimiter)] for line in lines]
    widths = [len(row) for row in rows]
    width = max(widths, key=lambda count: (widths.count(count), count), default=0)
    cells = [cell for row in rows if len(row) == width for cell in row if cell]
    values = sum(number(cell) or is_clock(cell) for cell in cells)
    share = values / max(1, len(cells)) * widths.count(width) / max(1, len(rows))
    # Spaces are parts of names, too.
    return width > 1, round(share, 3), width if values == 0 and delimiter != SPACES else 0
