"""Proposes a map of columns from headers and data: what is understood, for the user to confirm."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import TABLES, TIME
from ehls_ros.recording.headers import Recognised, recognised
from ehls_ros.recording.load import raw
from ehls_ros.recording.units import ELECTRICAL, UNITS
from ehls_ros.trajectory import READABLE


class Seen(NamedTuple):
    """A column as it was understood.

    Attributes:
        header: what its header says.
        smallest: least value, in the column's own unit; NaN if it is not of numbers.
        largest: greatest value.
        missing: fraction of values that are missing.
    """

    header: Recognised
    smallest: float
    largest: float
    missing: float

    @property
    def numeric(self) -> bool:
        """Whether the column is of numbers."""
        return not np.isnan(self.smallest)


class Table(NamedTuple):
    """A file as it was understood.

    Attributes:
        name: of the file.
        columns: its columns, in order.
        rows: number of rows looked at.
        rate: samples per second; NaN if no column of time is sure.
        unevenness: largest deviation of a time step from the usual one, relative to it.
    """

    name: str
    columns: tuple[Seen, ...]
    rows: int
    rate: float
    unevenness: float


def look(path: Path) -> Table:
    """Look at the columns of a file.

    Raises:
        BadInput: it cannot be read, or has no columns.
    """
    table = raw(path)
    if not table:
        raise BadInput("it has no column", str(path), "a header row of names and a row per sample")
    headers = recognised(list(table))
    seen = []
    for header, values in zip(headers, table.values(), strict=True):
        finite = values[np.isfinite(values)] if values is not None else np.empty(0)
        smallest, largest = (float(np.min(finite)), float(np.max(finite))) if finite.size else (np.nan, np.nan)
        missing = 1.0 - finite.size / max(1, values.size) if values is not None else 1.0
        seen.append(Seen(header, smallest, largest, missing))
    rate, unevenness = _rate(headers, table)
    return Table(path.name, tuple(seen), max((len(v) for v in table.values() if v is not None), default=0), rate, unevenness)


def _rate(headers: list[Recognised], table: Mapping[str, object]) -> tuple[float, float]:
    for header in headers:
        values = table[header.column]
        if header.signal == TIME and header.sureness in ("contract", "stated") and isinstance(values, np.ndarray):
            steps = np.diff(values) * (UNITS[header.unit].scale if header.unit else 1.0)
            usual = float(np.median(steps)) if steps.size else 0.0
            if usual > 0.0:
                return 1.0 / usual, float(np.nanmax(np.abs(steps - usual))) / usual
    return np.nan, np.nan


def proposed_map(tables: list[Table]) -> str:
    """Return the text of a map: what is sure as entries, what is not as comments to be completed."""
    lines = ["# Columns as `ehls columns` understood them. Check every line; a line with # is not used until it is completed."]
    several = len(tables) > 1
    if several:
        lines.append(f"{TABLES}:")
        for table in tables:
            time = next(
                (_entry(c.header) for c in table.columns if c.header.signal == TIME and c.header.sureness == "stated"), ""
            )
            lines.append(f"  {json.dumps(table.name, ensure_ascii=False)}: {time or '{name: time_s}'}")
    taken: dict[str, str] = {}
    for table in tables:
        if several:
            lines.append(f"# --- {table.name}")
        lines += _lines(table, several, taken)
    return "\n".join(lines) + "\n"


def _lines(table: Table, several: bool, taken: dict[str, str]) -> Iterator[str]:
    for column in table.columns:
        header = column.header
        if header.sureness == "contract" or (several and header.signal == TIME and header.sureness == "stated"):
            continue
        name = json.dumps(header.column, ensure_ascii=False)
        if not column.numeric:
            yield f"# {name} is not a column of numbers"
            continue
        span = f"{column.smallest:.4g} to {column.largest:.4g}"
        if header.sureness == "stated" and header.signal not in taken:
            taken[header.signal] = table.name
            of = f", table: {json.dumps(table.name, ensure_ascii=False)}" if several else ""
            hint = "; if it sits between piston and load: load_cell_n" if header.signal == "force_n" else ""
            yield f"{header.signal}: {_entry(header)[:-1]}{of}}}  # {span}{hint}"
            continue
        doubt = header.open or f"{header.signal} is in {taken.get(header.signal, '')} already"
        yield f"# {header.signal or 'which_signal'}: {_entry(header)}  # {span}; {doubt}"


def _entry(header: Recognised) -> str:
    name = json.dumps(header.column, ensure_ascii=False)
    if not header.unit:
        return f"{{name: {name}, unit: ?}}" if header.sureness != "contract" else f"{{name: {name}}}"
    gain = ", gain: ?" if UNITS[header.unit].quantity in ELECTRICAL else ""
    return f"{{name: {name}, unit: {json.dumps(header.unit, ensure_ascii=False)}{gain}}}"


def si_unit(signal: str) -> str:
    """Return the unit of a signal of the data contract."""
    return "s" if signal == TIME else READABLE[signal].unit if signal in READABLE else ""
