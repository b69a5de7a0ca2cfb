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
from ehls_ros.recording.entries import KEY
from ehls_ros.recording.headers import NO_UNIT, Recognised, recognised
from ehls_ros.recording.load import is_table, raw
from ehls_ros.recording.named_topics import Found, every_topic
from ehls_ros.recording.time_axis import RowName, time_axis
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


ONE_SIDED, FAR = 0.75, 0.01
"""Distance of the middle of a position from 0 above which its scale may be absolute: as a fraction of its range, and in m."""


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

    @property
    def absolute(self) -> str:
        """Remark on a position that may not be zero at mid-stroke; empty for others."""
        header = self.header
        if header.signal != "position_m" or header.certainty not in ("contract", "stated") or not self.numeric:
            return ""
        scale = UNITS[header.unit].scale if header.unit else 1.0
        middle, span = 0.5 * scale * (self.smallest + self.largest), scale * (self.largest - self.smallest)
        if abs(middle) < max(ONE_SIDED * span, FAR):
            return ""
        return f"0 has to be at mid-stroke: offset: {-middle:.4g} puts it at the middle of this recording; take the stroke's"


class Table(NamedTuple):
    """Interpretation of a file or of a topic of a bag.

    Attributes:
        name: name of the file or topic.
        columns: its columns, in order.
        rows: number of rows examined.
        rate: samples per second; NaN if no time column is certain.
        unevenness: largest relative deviation of a time step from the usual one, gaps left out.
        remarks: layout of the file, and repairs, gaps or errors of the time axis; one sentence each.
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
        return _topics(path)
    table = raw(path)
    if not table.names:
        raise BadInput("it has no column", str(path), "a header row of names and a row per sample")
    axes = tuple(dict.fromkeys(table.time_of.values()))
    headers = [header for header in recognised(table.names, table.units) if header.column not in axes]
    if axes:
        # The file's times are used unless the map replaces them.
        headers = [
            h._replace(certainty="unsure", open="instead of the times of the file?") if _is_time(h) else h for h in headers
        ]
    notes: list[str] = []
    seen = tuple(
        _seen(header, values)._replace(wrong=table.wrong.get(header.column, "") if values is None else "no cell has a value")
        for header in headers
        for values in [table.values.get(header.column)]
    )
    if not any(column.numeric for column in seen):
        listed = ", ".join(f"{name}: {table.wrong[name]}" if name in table.wrong else name for name in table.names)
        raise BadInput(f"no column has numbers (found: {listed})", str(path), "a row of numbers per sample")
    if axes:
        units = {axis: unit_of(table.units.get(axis, "s")) or "s" for axis in axes}
        stated = [_Axis(axis, units[axis], table.values[axis]) for axis in axes]
    else:
        sure = [h for h in headers if _is_time(h)]
        # Without a unit, seconds are the likely ones: said, since only a rate is shown.
        likely = [h for h in headers if h.signal == TIME and h.open == NO_UNIT and table.values.get(h.column) is not None]
        used = sure[:1] or (likely if len(likely) == 1 else [])
        stated = [_Axis(h.column, h.unit or "s", table.values.get(h.column)) for h in used]
        if used and not sure:
            notes.append(f"the rate is that of '{used[0].column}' in s, whose unit is not given")
    times = {axis.name: axis.values * UNITS[axis.unit].scale for axis in stated if axis.values is not None}
    rows = max((len(values) for values in table.values.values() if values is not None), default=0)
    found = {name: _checked(values, str(path), table.place) for name, values in times.items()}
    remarks = [*table.remarks, *notes]
    for name, axis in found.items():
        remarks += [f"{name}: {remark}" if len(found) > 1 else remark for remark in axis.remarks]
    seen, missing = _units_asked_once(seen)
    remarks += missing
    sentences = tuple(_axis_sentence(name, times[name], found[name], table.time_of) for name in axes if name in times)
    common = next(iter(found.values())) if len(found) == 1 else UNKNOWN_AXIS
    return [Table(path.name, seen, rows, common.rate, common.unevenness, tuple(remarks), sentences)]


def _units_asked_once(seen: tuple[Seen, ...]) -> tuple[tuple[Seen, ...], list[str]]:
    """Replace the question for the unit of each column by one sentence, if no column but the time states a unit."""
    others = [column for column in seen if column.numeric and column.header.signal != TIME]
    asked = [column for column in seen if column.numeric and NO_UNIT in column.header.open]
    if len(asked) < 2 or any(column.header.unit or column.header.certainty == "contract" for column in others):
        return seen, []
    brief = {column.header.column: column.header.open.replace(NO_UNIT, "unit?") for column in asked}
    out = tuple(
        column._replace(header=column.header._replace(open=brief.get(column.header.column, column.header.open)))
        for column in seen
    )
    example = f"{asked[0].header.column} [{'s' if asked[0].header.signal == TIME else 'mm'}]"
    where = f"in place of each \"?\" in the map, or in the file behind the names, such as '{example}', or in a row below them"
    return out, [f"no column states a unit: write it {where}"]


class _Axis(NamedTuple):
    name: str
    unit: str
    values: NDArray[np.float64] | None


class _Checked(NamedTuple):
    """Rate, unevenness and remarks of a time axis; the error of a wrong axis is a remark."""

    rate: float
    unevenness: float
    remarks: tuple[str, ...]


UNKNOWN_AXIS = _Checked(np.nan, np.nan, ())


def _is_time(header: Recognised) -> bool:
    return header.signal == TIME and header.certainty in ("contract", "stated")


def _axis_sentence(name: str, times: NDArray[np.float64], axis: _Checked, time_of: Mapping[str, str]) -> str:
    """Describe a time axis: rate, range and columns."""
    uneven = f", time steps differ by up to {100 * axis.unevenness:.2g} %" if axis.unevenness > MIN_UNEVENNESS else ""
    span = f", {times[0]:.6g} to {times[-1]:.6g} s" if len(times) else ""
    columns = [column for column, own in time_of.items() if own == name]
    more = f" and {len(columns) - MAX_SHOWN} more" if len(columns) > MAX_SHOWN else ""
    return f"{name}: {len(times)} rows, {axis.rate:.4g} Hz{uneven}{span} ({', '.join(columns[:MAX_SHOWN])}{more})"


def _topics(path: Path) -> list[Table]:
    """Interpret the topics of a bag; those left out, and remarks on the bag, are tables without columns."""
    found, left_out, remarks = every_topic(path)
    if not found:
        shown = "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        raise BadInput(f"no topic has numbers ({shown or 'it has no topic'})", str(path), "a bag with topics of numbers")
    said = [*((name, f"left out: {reason}") for name, reason in left_out.items()), *((path.name, remark) for remark in remarks)]
    others = (Table(name, (), 0, np.nan, np.nan, (remark,)) for name, remark in said)
    return [*(_topic(name, messages) for name, messages in found.items()), *others]


def _topic(name: str, found: Found) -> Table:
    """Interpret a topic by its name and by the unit that its type implies."""
    last = name.rpartition("/")[2]
    # In brackets, a label would count as a unit.
    words = {field: KEY.sub(r"_\1", field) for field in found.fields}
    labels = [last if field in PLAIN else f"{last}_{words[field]}" for field in found.fields]
    units = [
        next((unit for ending, unit in UNITS_OF_FIELDS.items() if f"{found.type}.{field}".endswith(ending)), "")
        for field in found.fields
    ]
    headers = recognised([f"{label} [{unit}]" if unit else label for label, unit in zip(labels, units, strict=True)])
    named = [header._replace(column=field) for header, field in zip(headers, found.fields, strict=True)]
    seen = tuple(_seen(header, values) for header, values in zip(named, found.fields.values(), strict=True))
    axis = _checked(found.time, name, lambda row: f"message {row + 1}")
    # A clock that was set is already among the remarks, with the times of reception.
    own = () if found.remarks and np.any(np.diff(found.time) < 0.0) else axis.remarks
    return Table(name, seen, len(found.time), axis.rate, axis.unevenness, (*found.remarks, *own))


def _seen(header: Recognised, values: NDArray[np.float64] | None) -> Seen:
    finite = values[np.isfinite(values)] if values is not None else np.empty(0)
    smallest, largest = (float(np.min(finite)), float(np.max(finite))) if finite.size else (np.nan, np.nan)
    return Seen(header, smallest, largest, 1.0 - finite.size / max(1, values.size) if values is not None else 1.0)


def _checked(times: NDArray[np.float64], where: str, row_name: RowName) -> _Checked:
    try:
        axis = time_axis(times, where, row_name)
    except BadInput as error:
        place = error.where.removeprefix(where).removeprefix(", ")
        steps = np.diff(times)
        usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.nan
        return _Checked(1.0 / usual, 0.0, (f"{place}: {error.what}; expected {error.expected}".removeprefix(": "),))
    return _Checked(axis.rate, axis.unevenness, axis.remarks)


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
    if is_topic(table.name) or not table.columns:
        yield from (f"# {remark}" for remark in table.remarks)
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
            hint += f"; {column.absolute}" if column.absolute else ""
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
