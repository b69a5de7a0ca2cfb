"""Layout of a table in a text file: encoding, delimiter, decimal sign, and the lines of names, units and first values."""

import codecs
import csv
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from ehls_ros.recording.header_row import COMMENT, Header, header_of, is_clock, tail_of

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
        said = (
            f"{self.encoding.removesuffix('-sig')}, {DELIMITERS[self.delimiter]} between cells, decimal {point}, {names}{units}"
        )
        return "" if said == PLAIN else f"read as {said}, values from line {self.header.first + 1}"


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
    encoding = _encoding(content, whole)
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


def _encoding(content: bytes, whole: bool) -> str:
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
    told = sum(number(cell) or is_clock(cell) for cell in cells)
    share = told / max(1, len(cells)) * widths.count(width) / max(1, len(rows))
    # Spaces are parts of names, too.
    return width > 1, round(share, 3), width if told == 0 and delimiter != SPACES else 0
