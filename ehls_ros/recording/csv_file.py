"""Reading of text tables with pandas, and writing of CSV files in the format of the data contract."""

import io
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording import limits
from ehls_ros.recording.columns import TIME, numbered, unique_names
from ehls_ros.recording.limits import Deadline
from ehls_ros.recording.regular_file import check_regular
from ehls_ros.recording.table import Pick, RawTable, check_length
from ehls_ros.recording.table_layout import BEGINNING, SPACES, Kind, Layout, is_number, kinds_of, layout_of, split
from ehls_ros.recording.table_sections import Table, sections_of, tables_of
from ehls_ros.recording.times import seconds_of_clock
from ehls_ros.trajectory import Trajectory

BLOCK = 2**20
"""Length of text read between two checks of the limits [characters]."""

CHECKED_LINES = 65536
"""Number of lines between two checks of the limits, where a file has several tables."""

SAMPLE = 30
"""Number of first rows from which the kinds of the columns of such a table are determined."""

ROWS_WRITTEN = 16384
"""Number of rows written together."""

EXPECTED_FILE = "a CSV file"


def read_csv(path: Path, pick: Pick | None = None) -> RawTable:
    """Read a table from a text file: CSV in any of the layouts of :mod:`table_layout`.

    Args:
        path: the file. Of several tables in it, that with most rows is read by the names of its columns; those of the others
            are called ``table 1/name`` and so on. Sections with the same header are one table.
        pick: returns the names of the columns to read, whose cells must be numbers, times or empty; None: all columns, where
            one with any other cell becomes None.

    Returns:
        The table. An empty cell is NaN.

    Raises:
        BadInput: the file cannot be read, or a row or cell is wrong.
    """
    where = str(path)
    size = check_regular(path, limits.TABLE, EXPECTED_FILE, larger=limits.TABLE_LARGER)
    deadline = Deadline(size, where)
    try:
        layout = layout_of(path)
        if not _begins_with_several(path, layout, where):
            try:
                return _read_one(path, layout, pick, deadline)
            except _WrongRow:
                tables = _tables(path, layout, deadline)
                if sum(len(table.ranges) for table in tables) < 2:
                    raise
        return _read_several(path, layout, pick, deadline)
    except OSError as error:
        raise BadInput(f"the file cannot be read ({reason(error)})", where, EXPECTED_FILE) from None


class _WrongRow(BadInput):
    """A row with another number of cells: the file may have several tables."""


def _read_one(path: Path, layout: Layout, pick: Pick | None, deadline: Deadline) -> RawTable:
    """Read a file whose rows all belong to one table without interruption."""
    where, header = str(path), layout.header
    unique = unique_names(header.names)
    wanted = unique if pick is None else pick(header.names)
    with path.open(encoding=layout.encoding, errors="replace") as stream:
        places = sorted({unique.index(name) for name in wanted})
        columns = ParsedColumns(layout, places, pick is None, deadline, where)
        values = columns.read(_Lines(stream, layout, deadline, where)) if places else {}
    clocks = {name: "s" for name, kind in zip(unique, header.kinds, strict=True) if kind == "clock"}
    return RawTable(
        header.names,
        {unique[place]: column for place, column in values.items()},
        "line",
        header.first + 1,
        {**header.units, **clocks},
        tuple(filter(None, [layout.sentence(), *columns.remarks])),
        {unique[place]: cell for place, cell in columns.wrong.items()},
    )


def physical_lines(path: Path, encoding: str, deadline: Deadline) -> Iterator[str]:
    """Yield the lines of a file without their ends.

    Args:
        path: the file.
        encoding: its encoding.
        deadline: deadline for reading it.

    Raises:
        BadInput: a line is too long, or the deadline has passed.
    """
    where = str(path)
    with path.open(encoding=encoding, errors="replace") as stream:
        for number, line in enumerate(iter(partial(stream.readline, limits.LINE + 2), ""), start=1):
            if len(line) > limits.LINE + 1:
                expected = f"a CSV file with one line per sample, of at most {limits.LINE}"
                raise BadInput(f"the line has more than {limits.LINE} characters", f"{where}, line {number}", expected)
            if number % CHECKED_LINES == 0:
                deadline.check()
            yield line.removesuffix("\n")


def _begins_with_several(path: Path, layout: Layout, where: str) -> bool:
    """Return whether the beginning of a file has several sections."""
    with path.open(encoding=layout.encoding, errors="replace") as stream:
        lines = stream.read(BEGINNING).split("\n")[:-1]
    try:
        return len(list(islice(sections_of(lines, layout.delimiter, layout.decimal, where), 2))) > 1
    except BadInput:
        return False  # reading it as one table reports the reason


def _tables(path: Path, layout: Layout, deadline: Deadline) -> list[Table]:
    lines = physical_lines(path, layout.encoding, deadline)
    return tables_of(sections_of(lines, layout.delimiter, layout.decimal, str(path)))


def _read_several(path: Path, layout: Layout, pick: Pick | None, deadline: Deadline) -> RawTable:
    """Read a file with several tables, or with a table in several sections."""
    where = str(path)
    tables = _tables(path, layout, deadline)
    main = max(range(len(tables)), key=lambda k: (tables[k].rows, k))
    order = [main, *(k for k in range(len(tables)) if k != main)]
    prefix = {k: "" if k == main else f"table {k + 1}/" for k in order}
    names = tuple(
        prefix[k] + (name or numbered(place) if prefix[k] else name)
        for k in order
        for place, name in enumerate(tables[k].header.names)
    )
    origin = [(k, place) for k in order for place in range(len(tables[k].header.names))]
    unique = unique_names(names)
    wanted = unique if pick is None else pick(names)
    out = RawTable(names, {}, "line", tables[main].header.first + 1)
    units, remarks, used = dict[str, str](), list[str](), list[int]()
    for k in order:
        table = tables[k]
        own = unique_names(table.header.names)
        known = {place: name for name, (table_of, place) in zip(unique, origin, strict=True) if table_of == k}
        units |= {known[own.index(name)]: unit for name, unit in table.header.units.items()}
        places = sorted(place for place, name in known.items() if name in wanted)
        if not places:
            continue
        sample = [
            [cell.strip() for cell in split(line, layout.delimiter)]
            for block in islice(_ranges(path, layout, table, deadline), 1)
            for line in block.lines[:SAMPLE]
        ]
        kinds = tuple(kinds_of(sample, partial(is_number, decimal=layout.decimal)))
        header = table.header._replace(kinds=kinds)
        units |= {known[place]: "s" for place, kind in enumerate(kinds) if kind == "clock"}
        columns = ParsedColumns(layout._replace(header=header), places, pick is None, deadline, where)
        values = columns.read(_ranges(path, layout, table, deadline))
        remarks += columns.remarks
        used.append(k)
        out = out._replace(
            values={**out.values, **{known[place]: column for place, column in values.items()}},
            wrong={**out.wrong, **{known[place]: cell for place, cell in columns.wrong.items()}},
        )
    chosen = tables[used[0] if used else main]
    begins = np.cumsum([0, *(end - begin for begin, end in chosen.ranges)])
    return out._replace(
        first=chosen.header.first + 1,
        blocks=tuple((int(row), begin + 1) for row, (begin, _) in zip(begins[1:-1], chosen.ranges[1:], strict=True)),
        units=units,
        remarks=(layout._replace(header=chosen.header).sentence(), *_remarks(tables, main), *remarks),
    )


def _remarks(tables: Sequence[Table], main: int) -> Iterator[str]:
    """Describe the tables of a file with several."""
    for k in [main, *(k for k in range(len(tables)) if k != main)]:
        table, count = tables[k], len(tables[k].ranges)
        extent = f"{table.rows} rows in {count} sections, the first" if count > 1 else f"{table.rows} rows"
        if k == main:
            of = f"table {k + 1} of {len(tables)} is read" if len(tables) > 1 else "sections with the same columns are joined"
            yield f"{of}: {extent} from line {table.header.first + 1} on"
        else:
            shown = ", ".join(f"'table {k + 1}/{name}'" for name in table.header.names if name)
            yield f"table {k + 1}, {extent} from line {table.header.first + 1} on, is read only if the map names {shown}"


def _ranges(path: Path, layout: Layout, table: Table, deadline: Deadline) -> "Iterator[Block]":
    """Yield the lines of values of a table."""
    lines, place = physical_lines(path, layout.encoding, deadline), 0
    for begin, end in table.ranges:
        next(islice(lines, begin - place, begin - place), None)  # skip the lines before
        place = end
        for first in range(begin, end, CHECKED_LINES):
            yield Block(list(islice(lines, min(CHECKED_LINES, end - first))), first + 1)


class Block(NamedTuple):
    """Complete lines of a file, with the number of the first."""

    lines: list[str]
    first: int


class _Lines:
    """Lines of values in blocks; rejects lines with another number of cells, and overlong lines during reading."""

    def __init__(self, stream: TextIO, layout: Layout, deadline: Deadline, where: str) -> None:
        self._stream, self._layout, self._deadline, self._where = stream, layout, deadline, where
        self._cells = len(layout.header.names)

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks."""
        number, skip, rest = 1, self._layout.header.first, ""
        for piece in chain(iter(partial(self._stream.read, BLOCK), ""), [None]):
            self._deadline.check()
            lines = (rest + (piece or "")).split("\n")
            rest = lines.pop() if piece is not None else ""
            if max(map(len, [*lines, rest])) > limits.LINE:
                place = next(k for k, line in enumerate([*lines, rest]) if len(line) > limits.LINE)
                expected = f"a CSV file with one line per sample, of at most {limits.LINE}"
                what = f"the line has more than {limits.LINE} characters"
                raise BadInput(what, f"{self._where}, line {number + place}", expected)
            block = Block(lines[skip:], number + min(skip, len(lines)))
            number, skip = number + len(lines), max(0, skip - len(lines))
            yield from self._checked(block)

    def _checked(self, block: Block) -> Iterator[Block]:
        """Yield a block whose lines all have one cell per name; trailing white space of the file is dropped."""
        wrong = self._wrong(block.lines)
        if wrong is None:
            if block.lines:
                yield block
            return
        line = block.lines[wrong]
        following = iter(partial(self._stream.read, BLOCK), "")
        if not any(map(str.strip, block.lines[wrong:])) and not any(map(str.strip, following)):
            if wrong:
                yield Block(block.lines[:wrong], block.first)
            return
        cells = len(split(line, self._layout.delimiter)) if line.strip() else 0
        what, where = f"the row has {cells} cells", f"{self._where}, line {block.first + wrong}"
        raise _WrongRow(what, where, f"{self._cells}, as in the header; or no such line")

    def _wrong(self, lines: Sequence[str]) -> int | None:
        """Return the index of the first line with another number of cells."""
        delimiter = self._layout.delimiter
        if delimiter == SPACES or any('"' in line for line in lines):
            counts = [len(split(line, delimiter)) if line.strip() else 0 for line in lines]
        else:
            counts = [line.count(delimiter) + 1 if line else 0 for line in lines]
        if counts.count(self._cells) == len(counts):
            return None
        return next(k for k, count in enumerate(counts) if count != self._cells)


class ParsedColumns:
    """Columns of blocks of lines, parsed by pandas.

    Attributes:
        wrong: a non-numeric cell of a column, by the column's index, such as ``line 12 is 'abc'``.
        remarks: remarks on the reading of clock times.
    """

    def __init__(self, layout: Layout, places: Iterable[int], lenient: bool, deadline: Deadline, where: str) -> None:
        """Prepare reading.

        Args:
            layout: layout of the lines, each of which has a cell per name.
            places: indices of the columns to read.
            lenient: whether a column with a wrong cell becomes None instead of an error.
            deadline: deadline for reading the file.
            where: the file, for errors.
        """
        self._layout, self._where, self._lenient, self._deadline = layout, where, lenient, deadline
        # If every cell has to be a number, the first that is not will be reported.
        kinds = {place: layout.header.kinds[place] for place in places}
        self.kinds = {place: "number" if kind == "text" and not lenient else kind for place, kind in kinds.items()}
        self.wrong: dict[int, str] = {}
        self.remarks: list[str] = []

    def read(self, blocks: Iterable[Block]) -> dict[int, NDArray[np.float64] | None]:
        """Return the columns by their positions."""
        parts: dict[int, list[NDArray[Any]]] = {place: [] for place in self.kinds}
        rows = 0
        for block in blocks:
            if rows == 0:
                cells = split(block.lines[0], self._layout.delimiter)
                texts = {place: cells[place].strip() for place, kind in self.kinds.items() if kind == "text"}
                self.wrong = {place: f"line {block.first} is {cell[:40]!r}" for place, cell in texts.items() if cell}
            rows += len(block.lines)
            check_length(rows, len(parts), self._where)
            for place, values in self._block(block).items():
                parts[place].append(values)
        return {place: self._whole(self.kinds[place], pieces) for place, pieces in parts.items()}

    def _whole(self, kind: Kind, pieces: list[NDArray[Any]]) -> NDArray[np.float64] | None:
        if kind == "text":
            return None
        whole = np.concatenate(pieces) if pieces else np.empty(0)
        if kind != "clock":
            return whole
        clock = seconds_of_clock(whole)
        self.remarks += [clock.remark] if clock.remark else []
        return clock.seconds

    def _block(self, block: Block) -> dict[int, NDArray[Any]]:
        while True:
            places = [place for place, kind in self.kinds.items() if kind != "text"]
            try:
                return self._parsed(block.lines, places)
            except ValueError:
                place, line = self._first_wrong(block.lines, places)
            cell = split(block.lines[line], self._layout.delimiter)[place].strip()
            if not self._lenient:
                what = f"column '{self._layout.header.names[place]}' is {cell[:40]!r}"
                sign = "comma" if self._layout.decimal == "," else "point"
                expected = f"a number with a decimal {sign} and without separators of thousands, or an empty cell"
                raise BadInput(what, f"{self._where}, line {block.first + line}", expected)
            self.kinds[place] = "text"
            self.wrong[place] = f"line {block.first + line} is {cell[:40]!r}"

    def _first_wrong(self, lines: Sequence[str], places: Sequence[int]) -> tuple[int, int]:
        """Return column and line index of the first non-numeric cell, by bisection."""
        begin, end = 0, len(lines)
        while end - begin > 1:
            middle = (begin + end) // 2
            begin, end = (middle, end) if self._readable(lines[begin:middle], places) else (begin, middle)
        return next((place for place in places if not self._readable(lines[begin:end], [place])), places[0]), begin

    def _readable(self, lines: Sequence[str], places: Sequence[int]) -> bool:
        try:
            self._parsed(lines, places)
        except ValueError:
            return False
        return True

    def _parsed(self, lines: Sequence[str], places: Sequence[int]) -> dict[int, NDArray[Any]]:
        self._deadline.check()
        if not places:
            return {}
        pandas: Any = import_module("pandas")
        # From 3.1 on, exact parsing of numbers is the default.
        exact = {} if tuple(map(int, pandas.__version__.split(".")[:2])) >= (3, 1) else {"float_precision": "round_trip"}
        table = pandas.read_csv(
            io.StringIO("\n".join(lines)),
            sep=self._layout.delimiter,
            decimal=self._layout.decimal,
            header=None,
            names=range(len(self._layout.header.names)),
            usecols=places,
            dtype={place: str if self.kinds[place] == "clock" else np.float64 for place in places},
            skipinitialspace=True,
            **exact,
        )
        return {place: table[place].to_numpy() for place in places}


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """Write a CSV file from which :func:`read_csv` restores every value exactly.

    Signals of the friction elements become one column each, such as ``friction_elements_n_1``. Metadata are not written.

    Args:
        path: the file; an existing one is replaced.
        trajectory: trajectory to be written.

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
        for start in range(0, len(trajectory), ROWS_WRITTEN):
            block = np.column_stack([column[start : start + ROWS_WRITTEN] for column in columns.values()])
            stream.writelines(",".join(map(repr, row)) + "\n" for row in block.tolist())


def _columns(trajectory: Trajectory) -> Iterator[tuple[str, NDArray[np.float64]]]:
    yield TIME, trajectory.time_s
    for name, values in trajectory.signals.items():
        if values.ndim == 1:
            yield name, values
        else:
            yield from ((f"{name}_{number}", column) for number, column in enumerate(values.T, start=1))
