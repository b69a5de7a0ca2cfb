"""Proposal of a map of columns from headers and data, for the user to confirm."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.diagnosis.record import COMMAND, SPOOL
from ehls_ros.diagnosis.stages import CHANNELS, STAGES, formable
from ehls_ros.diagnosis.verdict import NEEDED_SIGNALS
from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import ELECTRICAL, TABLES, TIME, is_topic, unit_of
from ehls_ros.recording.conversion import given_by
from ehls_ros.recording.headers import Recognised, recognised
from ehls_ros.recording.load import is_table, raw
from ehls_ros.recording.named_topics import Found, every_topic
from ehls_ros.units import UNITS

UNITS_OF_FIELDS: Mapping[str, str] = {
    "sensor_msgs/msg/FluidPressure.fluid_pressure": "Pa",
    "sensor_msgs/msg/Temperature.temperature": "°C",
    **{f"force.{axis}": "N" for axis in "xyz"},
    **{f"torque.{axis}": "N m" for axis in "xyz"},
}
"""Units that standard ROS messages have by definition, by the end of type and field."""

MIN_UNEVENNESS = 0.01
"""Relative deviation of a time step from the usual one above which it is reported."""

MAX_SHOWN = 8
"""Maximum number of columns listed for a time axis."""

PLAIN = ("data", "fluid_pressure", "temperature")
"""Fields whose names add no information to that of their topic."""


class Seen(NamedTuple):
    """Interpretation of a column.

    Attributes:
        header: interpretation of its header.
        smallest: least value, in the column's unit; NaN if it is not numeric.
        largest: greatest value.
        missing: fraction of missing values.
        entry: further content of its entry in the map, beside name and unit.
        wrong: a non-numeric cell, if known.
    """

    header: Recognised
    smallest: float
    largest: float
    missing: float
    entry: str = ""
    wrong: str = ""

    @property
    def numeric(self) -> bool:
        """Whether the column is numeric."""
        return not np.isnan(self.smallest)


class Table(NamedTuple):
    """Interpretation of a file or of a topic of a bag.

    Attributes:
        name: name of the file or topic.
        columns: its columns, in order.
        rows: number of rows examined.
        rate: samples per second; NaN if no time column is certain.
        unevenness: largest relative deviation of a time step from the usual one.
        remarks: layout of the file, and times that do not increase; one sentence each.
        axes: description of each time axis, if the file states the times of its columns.
    """

    name: str
    columns: tuple[Seen, ...]
    rows: int
    rate: float
    unevenness: float
    remarks: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()


class Valve(NamedTuple):
    """Rated data of a valve: signal at full stroke, or both ends of its range, and stroke.

    Attributes:
        ends: the signal at both ends of the stroke, in its unit.
        unit: unit of the signal.
        stroke: spool displacement at the upper end [m]; that at the lower end is the opposite.
    """

    ends: tuple[float, float]
    unit: str
    stroke: float


VALVE = re.compile(
    r"\s*(?:(?P<low>[-+\d.eE]+)\s*\.\.\s*)?(?P<high>[-+\d.eE]+)\s*(?P<unit>\D+?)\s*=\s*(?P<stroke>[-+\d.eE]+)\s*(?P<length>\D+)"
)
EXPECTED_VALVE = "the signal of full stroke and the stroke, such as '10 V = 1 mm', '40 mA = 1 mm' or '4..20 mA = 1 mm'"


def valve_data(text: str) -> Valve:
    """Parse a valve's rated data: ``10 V = 1 mm``, with the opposite stroke at the opposite signal, or ``4..20 mA = 1 mm``.

    Raises:
        BadInput: the text has another form.
    """
    match = VALVE.fullmatch(text)
    unit, length = (unit_of(match[key]) for key in ("unit", "length")) if match else (None, None)
    try:
        if match and unit and length and UNITS[unit].quantity in ELECTRICAL and UNITS[length].quantity == "length":
            high, stroke = float(match["high"]), float(match["stroke"]) * UNITS[length].scale
            low = float(match["low"]) if match["low"] else -high
            if low != high and stroke != 0.0:
                return Valve((low, high), unit, stroke)
    except ValueError:
        pass
    raise BadInput(f"the valve's data are {text!r}", "command line", EXPECTED_VALVE)


def with_valve(tables: Sequence[Table], valve: Valve) -> list[Table]:
    """Return the tables with the valve's command and spool columns resolved by its rated data."""

    def known(column: Seen) -> Seen:
        header = column.header
        moved = header.certainty == "unsure" and header.signal in (COMMAND, SPOOL) and header.unit
        if not moved or UNITS[header.unit].quantity != UNITS[valve.unit].quantity:
            return column
        factor = UNITS[valve.unit].scale / UNITS[header.unit].scale
        low, high = (float(f"{factor * end:.12g}") for end in valve.ends)
        stated = header._replace(certainty="stated", open=f"by the valve's data: {low:g} to {high:g} {header.unit}")
        return column._replace(
            header=stated, entry=f", range: [{low!r}, {high!r}], means: [{-valve.stroke!r}, {valve.stroke!r}]"
        )

    return [table._replace(columns=tuple(map(known, table.columns))) for table in tables]


def look(path: Path) -> list[Table]:
    """Interpret the columns of a file, or the topics of a bag.

    Raises:
        BadInput: it cannot be read, or has no columns.
    """
    if not is_table(path):
        return [_topic(name, found) for name, found in every_topic(path).items()]
    table = raw(path)
    if not table.names:
        raise BadInput("it has no column", str(path), "a header row of names and a row per sample")
    axes = tuple(dict.fromkeys(table.time_of.values()))
    headers = recognised([name for name in table.names if name not in axes], table.units)
    if axes:
        # The file's times are used unless the map replaces them.
        headers = [
            h._replace(certainty="unsure", open="instead of the times of the file?") if _is_time(h) else h for h in headers
        ]
    seen = tuple(
        _seen(header, values)._replace(wrong=table.wrong.get(header.column, "") if values is None else "no cell has a value")
        for header in headers
        for values in [table.values[header.column]]
    )
    if not any(column.numeric for column in seen):
        listed = ", ".join(f"{name}: {table.wrong[name]}" if name in table.wrong else name for name in table.names)
        raise BadInput(f"no column has numbers (found: {listed})", str(path), "a row of numbers per sample")
    if axes:
        units = {axis: unit_of(table.units.get(axis, "s")) or "s" for axis in axes}
        stated = [_Axis(axis, units[axis], table.values[axis]) for axis in axes]
    else:
        stated = [_Axis(h.column, h.unit or "s", table.values[h.column]) for h in headers if _is_time(h)][:1]
    times = {axis.name: axis.values * UNITS[axis.unit].scale for axis in stated if axis.values is not None}
    rows = max((len(values) for values in table.values.values() if values is not None), default=0)
    remarks = list(table.remarks)
    for name, values in times.items():
        backwards = np.flatnonzero(np.diff(values) <= 0.0)
        if len(backwards):
            of = f" of {name}" if len(times) > 1 else ""
            first = table.place(int(backwards[0]) + 1)
            remarks.append(f"times{of} that do not increase: {len(backwards)}, the first in {first}")
    sentences = tuple(_axis_sentence(axis, times[axis], table.time_of) for axis in axes if axis in times)
    common = next(iter(times.values())) if len(times) == 1 else None
    return [Table(path.name, seen, rows, *_rate(common), tuple(remarks), sentences)]


class _Axis(NamedTuple):
    name: str
    unit: str
    values: NDArray[np.float64] | None


def _is_time(header: Recognised) -> bool:
    return header.signal == TIME and header.certainty in ("contract", "stated")


def _axis_sentence(axis: str, times: NDArray[np.float64], time_of: Mapping[str, str]) -> str:
    """Describe a time axis: rate, range and columns."""
    rate, unevenness = _rate(times)
    uneven = f", time steps differ by up to {100 * unevenness:.2g} %" if unevenness > MIN_UNEVENNESS else ""
    span = f", {times[0]:.6g} to {times[-1]:.6g} s" if len(times) else ""
    columns = [column for column, own in time_of.items() if own == axis]
    more = f" and {len(columns) - MAX_SHOWN} more" if len(columns) > MAX_SHOWN else ""
    return f"{axis}: {len(times)} rows, {rate:.4g} Hz{uneven}{span} ({', '.join(columns[:MAX_SHOWN])}{more})"


def _topic(name: str, found: Found) -> Table:
    """Interpret a topic by its name and by the unit that its type implies."""
    last = name.rpartition("/")[2]
    labels = [last if field in PLAIN else f"{last}_{field}" for field in found.fields]
    units = [
        next((unit for ending, unit in UNITS_OF_FIELDS.items() if f"{found.type}.{field}".endswith(ending)), "")
        for field in found.fields
    ]
    headers = recognised([f"{label} [{unit}]" if unit else label for label, unit in zip(labels, units, strict=True)])
    named = [header._replace(column=field) for header, field in zip(headers, found.fields, strict=True)]
    seen = tuple(_seen(header, values) for header, values in zip(named, found.fields.values(), strict=True))
    return Table(name, seen, len(found.time), *_rate(found.time))


def _seen(header: Recognised, values: NDArray[np.float64] | None) -> Seen:
    finite = values[np.isfinite(values)] if values is not None else np.empty(0)
    smallest, largest = (float(np.min(finite)), float(np.max(finite))) if finite.size else (np.nan, np.nan)
    return Seen(header, smallest, largest, 1.0 - finite.size / max(1, values.size) if values is not None else 1.0)


def _rate(times: NDArray[np.float64] | None) -> tuple[float, float]:
    steps = np.diff(times) if times is not None else np.empty(0)
    usual = float(np.median(steps)) if steps.size else 0.0
    return (1.0 / usual, float(np.nanmax(np.abs(steps - usual))) / usual) if usual > 0.0 else (np.nan, np.nan)


class Proposal(NamedTuple):
    """Proposed map of columns.

    Attributes:
        text: YAML with certain columns as entries, and others as comments to be completed.
        signals: signals of the data contract that it provides, including columns that need no entry.
        certain: number of columns that are certain.
        unsure: number of columns to be checked.
    """

    text: str
    signals: frozenset[str]
    certain: int
    unsure: int

    def unjudged(self) -> dict[str, str]:
        """Return the stages that a diagnosis cannot judge, with their required signals; a spring is assumed."""
        channels = formable(given_by(self.signals), springless=False)
        return {stage: NEEDED_SIGNALS[stage] for stage in STAGES if stage not in {CHANNELS[channel] for channel in channels}}


def proposed_map(tables: Sequence[Table]) -> Proposal:
    """Propose a map of columns.

    Args:
        tables: interpretation of the files of one recording, or of a bag's topics.
    """
    lines = ["# Columns as `ehls columns` understood them. Check every line; a line with # is not used until it is completed."]
    several = len(tables) > 1 or any(is_topic(table.name) for table in tables)
    if several and not any(is_topic(table.name) for table in tables):
        lines.append(f"{TABLES}:")
        for table in tables:
            time = next(
                (_entry(c.header) for c in table.columns if c.header.signal == TIME and c.header.certainty == "stated"), ""
            )
            own = "null  # its columns have times" if table.axes else "{name: time_s}"
            lines.append(f"  {json.dumps(table.name, ensure_ascii=False)}: {time or own}")
    taken: dict[str, str] = {}
    for table in tables:
        if several:
            lines.append(f"# --- {table.name}")
        lines += _lines(table, several, taken)
    headers = [column.header for table in tables for column in table.columns if column.numeric]
    damaged = [c for table in tables for c in table.columns if not c.numeric and c.header.certainty in ("contract", "stated")]
    ready = [header for header in headers if header.certainty == "contract"]
    times = [header for header in headers if header.certainty == "stated" and header.signal == TIME]
    timed = (several and bool(times)) or any(table.axes or is_topic(table.name) for table in tables)
    signals = frozenset({*taken, *([TIME] if timed else []), *(header.signal for header in ready)})
    certain = len(ready) + len(taken) + (len(times) if several else 0)
    return Proposal("\n".join(lines) + "\n", signals, certain, len(headers) - certain + len(damaged))


def _lines(table: Table, several: bool, taken: dict[str, str]) -> Iterator[str]:
    for column in table.columns:
        header = column.header
        name = json.dumps(header.column, ensure_ascii=False)
        if not column.numeric:
            yield f"# {name} is not a column of numbers{f': {column.wrong}' if column.wrong else ''}"
            continue
        if header.certainty == "contract" or (several and header.signal == TIME and header.certainty == "stated"):
            continue
        of = f", table: {json.dumps(table.name, ensure_ascii=False)}" if several else ""
        span = f"{column.smallest:.4g} to {column.largest:.4g}"
        if header.certainty == "stated" and header.signal not in taken:
            taken[header.signal] = table.name
            hint = "; if it sits between piston and load: load_cell_n" if header.signal == "force_n" else ""
            yield f"{header.signal}: {_entry(header)[:-1]}{column.entry}{of}}}  # {span}{hint}"
            continue
        doubt = header.open or f"{header.signal} is in {taken.get(header.signal, '')} already"
        yield f"# {header.signal or 'which_signal'}: {_entry(header)[:-1]}{of}}}  # {span}; {doubt}"


def _entry(header: Recognised) -> str:
    name = json.dumps(header.column, ensure_ascii=False)
    if not header.unit:
        return f'{{name: {name}, unit: "?"}}' if header.certainty != "contract" else f"{{name: {name}}}"
    known = header.certainty == "stated" or UNITS[header.unit].quantity not in ELECTRICAL
    gain = "" if known else ', range: ["?", "?"], means: ["?", "?"]'
    return f"{{name: {name}, unit: {json.dumps(header.unit, ensure_ascii=False)}{gain}}}"
