"""Proposes a map of columns from headers and data: what is understood, for the user to confirm."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import TABLES, TIME, is_topic
from ehls_ros.recording.headers import Recognised, recognised
from ehls_ros.recording.load import is_table, raw
from ehls_ros.recording.named_topics import Found, every_topic
from ehls_ros.recording.units import ELECTRICAL, UNITS
from ehls_ros.trajectory import READABLE

UNITS_OF_FIELDS: Mapping[str, str] = {
    "sensor_msgs/msg/FluidPressure.fluid_pressure": "Pa",
    "sensor_msgs/msg/Temperature.temperature": "°C",
    **{f"force.{axis}": "N" for axis in "xyz"},
    **{f"torque.{axis}": "Nm" for axis in "xyz"},
}
"""Units that ROS's own messages have by definition, by the end of type and field."""

PLAIN = ("data", "fluid_pressure", "temperature")
"""Fields whose name adds nothing to that of their topic."""


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
    """A file, or a topic of a bag, as it was understood.

    Attributes:
        name: of the file or topic.
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


def look(path: Path) -> list[Table]:
    """Look at the columns of a file, or at the topics of a bag.

    Raises:
        BadInput: it cannot be read, or has no columns.
    """
    if not is_table(path):
        return [_topic(name, found) for name, found in every_topic(path).items()]
    table = raw(path)
    if not table:
        raise BadInput("it has no column", str(path), "a header row of names and a row per sample")
    headers = recognised(list(table))
    seen = tuple(_seen(header, values) for header, values in zip(headers, table.values(), strict=True))
    times = next(
        (_seconds(h, table[h.column]) for h in headers if h.signal == TIME and h.sureness in ("contract", "stated")), None
    )
    return [Table(path.name, seen, max((len(v) for v in table.values() if v is not None), default=0), *_rate(times))]


def _topic(name: str, found: Found) -> Table:
    """Return a topic as it was understood: by its own name, and by the unit that its type stands for."""
    last = name.rpartition("/")[2]
    labels = [last if field in PLAIN else f"{last}_{field}" for field in found.fields]
    units = [_unit(f"{found.type}.{field}") for field in found.fields]
    headers = recognised([f"{label} [{unit}]" if unit else label for label, unit in zip(labels, units, strict=True)])
    named = [header._replace(column=field) for header, field in zip(headers, found.fields, strict=True)]
    seen = tuple(_seen(header, values) for header, values in zip(named, found.fields.values(), strict=True))
    return Table(name, seen, len(found.time), *_rate(found.time))


def _unit(field: str) -> str:
    return next((unit for ending, unit in UNITS_OF_FIELDS.items() if field.endswith(ending)), "")


def _seen(header: Recognised, values: NDArray[np.float64] | None) -> Seen:
    finite = values[np.isfinite(values)] if values is not None else np.empty(0)
    smallest, largest = (float(np.min(finite)), float(np.max(finite))) if finite.size else (np.nan, np.nan)
    return Seen(header, smallest, largest, 1.0 - finite.size / max(1, values.size) if values is not None else 1.0)


def _seconds(header: Recognised, values: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    return None if values is None else values * (UNITS[header.unit].scale if header.unit else 1.0)


def _rate(times: NDArray[np.float64] | None) -> tuple[float, float]:
    steps = np.diff(times) if times is not None else np.empty(0)
    usual = float(np.median(steps)) if steps.size else 0.0
    return (1.0 / usual, float(np.nanmax(np.abs(steps - usual))) / usual) if usual > 0.0 else (np.nan, np.nan)


def proposed_map(tables: list[Table]) -> str:
    """Return the text of a map: what is sure as entries, what is not as comments to be completed."""
    lines = ["# Columns as `ehls columns` understood them. Check every line; a line with # is not used until it is completed."]
    several = len(tables) > 1 or any(is_topic(table.name) for table in tables)
    if several and not any(is_topic(table.name) for table in tables):
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
        of = f", table: {json.dumps(table.name, ensure_ascii=False)}" if several else ""
        span = f"{column.smallest:.4g} to {column.largest:.4g}"
        if header.sureness == "stated" and header.signal not in taken:
            taken[header.signal] = table.name
            hint = "; if it sits between piston and load: load_cell_n" if header.signal == "force_n" else ""
            yield f"{header.signal}: {_entry(header)[:-1]}{of}}}  # {span}{hint}"
            continue
        doubt = header.open or f"{header.signal} is in {taken.get(header.signal, '')} already"
        yield f"# {header.signal or 'which_signal'}: {_entry(header)[:-1]}{of}}}  # {span}; {doubt}"


def _entry(header: Recognised) -> str:
    name = json.dumps(header.column, ensure_ascii=False)
    if not header.unit:
        return f"{{name: {name}, unit: ?}}" if header.sureness != "contract" else f"{{name: {name}}}"
    gain = ", gain: ?" if UNITS[header.unit].quantity in ELECTRICAL else ""
    return f"{{name: {name}, unit: {json.dumps(header.unit, ensure_ascii=False)}{gain}}}"


def si_unit(signal: str) -> str:
    """Return the unit of a signal of the data contract."""
    return "s" if signal == TIME else READABLE[signal].unit if signal in READABLE else ""
