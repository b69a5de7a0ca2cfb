"""Units of recorded signals, and the map of foreign column names and units to the names of the data contract."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from ehls_ros import units
from ehls_ros.errors import BadInput, one_of
from ehls_ros.recording.expression import expression
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import parse, quantity, text
from ehls_ros.trajectory import READABLE
from ehls_ros.units import QUANTITIES, UNITS

ELECTRICAL = ("current", "voltage", "ratio", "counts")
"""Quantities that represent another one through the gain of a converter, an amplifier or a valve."""

NEVER_RECORDED = ("area", "volume", "mass", "density", "stiffness", "damping")
"""Quantities that occur only in rig files: ``t`` above a column is the time, not tonnes."""

RECORDED = tuple(name for name, unit in UNITS.items() if unit.quantity not in NEVER_RECORDED)
"""Permitted units of a column."""


TIME = "time_s"

ELEMENT_SIGNALS = ("friction_elements_n", "friction_slipping")
"""Signals with one column per friction element: ``friction_elements_n_1``, ``friction_elements_n_2`` and so on."""

TABLES, BASE, CYLINDER, ROTARY = "tables", "base", "cylinder", "rotary"
"""Keys of a map other than names of signals."""

EXPECTED_MAP = "a mapping like 'position_m: {name: x, scale: 0.001, offset: 0.0}'"

EXPECTED_TABLES = "a list of files, or a mapping like 'fast.csv: {name: t, unit: ms}' of each file's time"


def quantity_of(name: str) -> str:
    """Return the quantity of a name in the data contract; empty if its unit is in no list."""
    return "time" if name == "time_s" else QUANTITIES.get(READABLE[name].unit, "") if name in READABLE else ""


def unit_of(text: str) -> str | None:
    """Return the standard spelling of a column's unit, ``g`` being an acceleration; None if it is not a permitted unit."""
    known = units.unit_of(text)
    return "gn" if known == "g" else known if known in RECORDED else None


NUMBERED = re.compile(r"column ([1-9][0-9]{0,5})\Z")
"""Name of a column by its number in the file, from 1."""


def numbered(place: int) -> str:
    """Return the name of a column by its number, from its index."""
    return f"column {place + 1}"


def place_of(name: str, names: Sequence[str]) -> int | None:
    """Return the index of a column by its name, or by its number if no column has this name; None if there is none.

    Args:
        name: such as ``Kraft``, or ``column 3`` for the third column of the file.
        names: names of all columns; of equal ones, the first is returned.
    """
    if name in names:
        return list(names).index(name)
    match = NUMBERED.match(name)
    place = int(match[1]) - 1 if match else len(names)
    return place if place < len(names) else None


def unique_names(names: Sequence[str]) -> list[str]:
    """Return the names of the columns, by number where a name is empty or occurs more than once."""
    count = Counter(names)
    return [name if name and count[name] == 1 else numbered(place) for place, name in enumerate(names)]


def unique_name(name: str, names: Sequence[str]) -> str:
    """Return the name of :func:`unique_names` for a name or number of a column; an unknown name is kept."""
    place = place_of(name, names)
    return name if place is None else names[place] if names[place] and names.count(names[place]) == 1 else numbered(place)


class Column(NamedTuple):
    """Source of a signal in a file: signal = ``gain`` · ``scale`` · value in SI units of ``unit`` + ``offset``."""

    name: Annotated[
        str,
        text(
            "name of the column in the file, or `column 3` by its number; of a bag, of the message's field, such as position[0]"
        ),
    ] = ""
    scale: Annotated[float, quantity("1", "factor; without a unit, SI units per unit of the column")] = 1.0
    offset: Annotated[float, quantity("SI", "added after scaling")] = 0.0
    unit: Annotated[str, text("unit of the column, such as mm, bar, kN, °C, mA or V")] = ""
    gain: Annotated[float, quantity("SI", "of a column in A, V, % or counts: the signal's SI units per A, V, 1 or count")] = 1.0
    fit_to: Annotated[str, text("for raw counts: the signal to which scale and offset are fitted")] = ""
    table: Annotated[str, text("the file that has the column, where several have one of this name; of a bag, the topic")] = ""
    expression: Annotated[str, text("instead of a name: columns of one unit, such as pA - pB, or `p A` - `p B`")] = ""
    range: Annotated[tuple[float, ...], text("two values of the column, such as [4, 20] of a transmitter in mA")] = ()
    means: Annotated[tuple[float, ...], text("the signal at both values of the range", "SI")] = ()
    rate: Annotated[float, quantity("Hz", "of time: sampling rate; name is the column of sample numbers, if there is one")] = (
        0.0
    )
    mend: Annotated[bool, text("of a topic's time: shift the messages after the clock was set back")] = False

    def plain(self) -> "Column":
        """Return the column with its unit, range and rate in scale and offset."""
        if self.range:
            (low, high), (at_low, at_high) = self.range, self.means
            scale = (at_high - at_low) / (high - low)
            return Column(self.name, scale, at_low - scale * low + self.offset, expression=self.expression)
        unit = UNITS[self.unit] if self.unit else UNITS["counts"]
        factor = self.gain * self.scale / (self.rate or 1.0)
        return Column(self.name, factor * unit.scale, factor * unit.offset + self.offset, expression=self.expression)

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the source columns; none for times derived from a rate."""
        if self.expression:
            return expression(self.expression).names
        return (self.name,) if self.name else ()

    def sources_in(self, names: Sequence[str]) -> bool:
        """Return whether all source columns are among the given names, or have a number of theirs."""
        return all(place_of(source, names) is not None for source in self.sources)

    @property
    def shown(self) -> str:
        """Name in messages."""
        return self.expression or self.name


class Cylinder(NamedTuple):
    """Areas of a differential cylinder."""

    area_a: Annotated[float, quantity("m^2", "area on which pressure A pushes towards +x", above=0.0)]
    area_b: Annotated[float, quantity("m^2", "area on which pressure B pushes towards -x", above=0.0)]

    @property
    def mean(self) -> float:
        """Area of the equivalent symmetric cylinder [m^2]."""
        return 0.5 * (self.area_a + self.area_b)


class Rotary(NamedTuple):
    """Lever arm that converts angle and torque to position and force."""

    radius: Annotated[float, quantity("m", "arm: position = radius · angle, force = torque / radius", above=0.0)]


Columns = Mapping[str, Column]
"""Columns by contract name."""


class ColumnMap(NamedTuple):
    """Map of the user's tables to the signals of the data contract.

    Attributes:
        columns: by contract name.
        tables: the files of one recording, or topics of a bag, each with its time column; None: that of the map. Empty: one
            file, or a bag.
        base: file or topic to whose clock the signals are resampled; empty: chosen by rate.
        cylinder: areas of both chambers; None if equal.
        rotary: lever arm of a rotary actuator; None for a linear one.
    """

    columns: Mapping[str, Column] = {}
    tables: Mapping[str, Column | None] = {}
    base: str = ""
    cylinder: Cylinder | None = None
    rotary: Rotary | None = None

    def plain(self) -> Columns:
        """Return the columns with units folded into scale and offset, for the readers of single tables."""
        return {name: column.plain() for name, column in self.columns.items()}


def read_columns(path: Path) -> ColumnMap:
    """Read a map of columns.

    Args:
        path: YAML file with an entry ``contract_name: {name: ..., unit: mm}`` for each mapped column, and the keys ``tables``,
            ``base``, ``cylinder`` and ``rotary`` where needed.

    Returns:
        The map.

    Raises:
        BadInput: the file cannot be read, or an entry is wrong.
    """
    return columns_from_mapping(read_yaml(path, "map of columns"), path)


def columns_from_mapping(data: Any, path: Path) -> ColumnMap:
    """Check a map of columns.

    Args:
        data: the parsed file.
        path: its path, for errors.

    Raises:
        BadInput: an entry is wrong.
    """
    if data is not None and not isinstance(data, Mapping):
        raise BadInput(f"it contains {data!r}", str(path), EXPECTED_MAP)
    content = dict(data or {})  # a file may contain only comments
    others = {key: content.pop(key, None) for key in (TABLES, BASE, CYLINDER, ROTARY)}
    columns = {str(name): _column(str(name), entry, path) for name, entry in content.items()}
    for name, column in columns.items():
        _check_fit(name, column, columns, path)
    tables = _tables(others[TABLES], path)
    topics = {column.table for column in columns.values() if is_topic(column.table)}
    if any(map(is_topic, tables)) and not all(map(is_topic, tables)):
        raise BadInput(f"its tables are {', '.join(tables)}", str(path), "files alone, or topics (/name) alone")
    base = others[BASE] or ""
    if base and base not in {*tables, *topics}:
        shown = ", ".join((*tables, *sorted(topics - tables.keys())))
        raise BadInput(f"base is {base!r}", str(path), f"one of the tables {shown or '(none are listed)'}")
    for name, column in columns.items():
        if column.table and column.table not in tables and not is_topic(column.table):
            raise BadInput(
                f"table is {column.table!r}", f"{path}, {name}", f"one of the tables {', '.join(tables) or '(none)'}"
            )
    return ColumnMap(
        columns, tables, base, _part(Cylinder, others[CYLINDER], CYLINDER, path), _part(Rotary, others[ROTARY], ROTARY, path)
    )


def _part(kind: type[Any], entry: object, key: str, path: Path) -> Any:
    if entry is None:
        return None
    if not isinstance(entry, dict):
        raise BadInput(f"it is {entry!r}", f"{path}, {key}", f"a mapping of {', '.join(kind._fields)}")
    return parse(kind, entry, f"{path}, {key}")


def _tables(entry: object, path: Path) -> dict[str, Column | None]:
    where = f"{path}, {TABLES}"
    if entry is None:
        return {}
    if isinstance(entry, list) and all(isinstance(name, str) for name in entry):
        if len(set(entry)) < len(entry):
            raise BadInput(f"it is {entry!r}", where, "each file once")
        return dict.fromkeys(entry)
    if not isinstance(entry, dict):
        raise BadInput(f"it is {entry!r}", where, EXPECTED_TABLES)
    return {
        str(name): None if time is None else _entry(TIME, time, f"{where}, {name}", EXPECTED_TABLES)
        for name, time in entry.items()
    }


def _column(name: str, entry: object, path: Path) -> Column:
    if not is_contract_name(name):
        raise BadInput(f"name '{name}' is unknown", str(path), one_of(name, (TIME, *READABLE)))
    return _entry(name, entry, f"{path}, {name}", EXPECTED_MAP)


def _entry(name: str, entry: object, where: str, expected: str) -> Column:
    if not isinstance(entry, dict):
        raise BadInput(f"it is {entry!r}", where, expected)
    column = parse(Column, entry, where)
    _check_source(name, column, entry, where)
    for key in ("scale", "gain"):
        if getattr(column, key) == 0:
            raise BadInput(f"{key} is 0", where, "a factor other than 0")
    if column.range or column.means:
        return _with_range(column, entry, where)
    if column.unit:
        return _with_unit(name, column, entry, where)
    if "gain" in entry:
        raise BadInput("gain is given without a unit", where, "unit: A, mA, V, mV, % or counts; or scale instead")
    return column


def _check_source(name: str, column: Column, entry: Mapping[str, object], where: str) -> None:
    """Reject a column whose source is missing or ambiguous."""
    if "rate" in entry and (name != TIME or column.rate <= 0.0 or entry.keys() & {"unit", "scale", "expression"}):
        raise BadInput(f"rate is {column.rate:g}", where, f"a positive rate in Hz, only for {TIME} and without unit or scale")
    if column.expression:
        if column.name:
            raise BadInput("both name and expression are given", where, "one of the two")
        try:
            expression(column.expression)
        except ValueError as error:
            expected = "arithmetic of columns such as pA - pB; other names between backticks"
            raise BadInput(f"expression is {column.expression!r}: {error}", where, expected) from None
    elif column.mend and where.partition(f", {TABLES}, ")[2][:1] != "/":
        raise BadInput("mend is given", where, f"it only under '{TABLES}', for a topic")
    elif not column.name and not column.rate:
        note = "the name of the column in the file, an expression of several columns, or of time a rate"
        raise BadInput("key 'name' is missing", where, note)


def _with_range(column: Column, entry: Mapping[str, object], where: str) -> Column:
    """Check two values of a column and their meaning."""
    for key, ends in (("range", column.range), ("means", column.means)):
        if len(ends) != 2 or ends[0] == ends[1]:
            expected = "two different numbers in both, such as range: [4, 20] and means: [-1.0e-3, 1.0e-3]"
            raise BadInput(f"{key} is {list(ends)}", where, expected)
    other = next((key for key in ("scale", "gain", "fit_to", "rate") if key in entry), None)
    if other is not None:
        raise BadInput(f"{other} is given beside a range", where, "one of the two")
    spelling = unit_of(column.unit) if column.unit else ""
    if spelling is None:
        raise BadInput(f"unit is {column.unit!r}", where, f"one of {', '.join(RECORDED)}; or none")
    return column._replace(unit=spelling)


def _with_unit(name: str, column: Column, entry: Mapping[str, object], where: str) -> Column:
    """Return the column with its unit in the standard spelling; reject a unit of another quantity."""
    spelling = unit_of(column.unit)
    if spelling is None:
        raise BadInput(f"unit is {column.unit!r}", where, f"one of {', '.join(RECORDED)}; or scale, in SI units per unit")
    found, wanted = UNITS[spelling].quantity, quantity_of(name)
    if found in ELECTRICAL:
        if "gain" not in entry and "scale" not in entry and not column.fit_to:
            what = f"unit is {spelling} and no gain is given"
            si = READABLE[name].unit if name in READABLE else "s"
            raise BadInput(what, where, f"gain: {si} per SI unit of it; or range: and means:, such as of 4 and 20 mA")
    elif "gain" in entry:
        raise BadInput(f"unit is {spelling}, which needs no gain", where, "a gain only with A, mA, V, mV, % or counts")
    elif found != wanted:
        raise BadInput(f"unit is {spelling}, a {found}", where, f"a unit of {wanted}" if wanted else "no unit but a scale")
    return column._replace(unit=spelling)


FITTED: Mapping[str, str] = {
    "position_m": "velocity_m_s",
    "velocity_m_s": "position_m",
    "angle_rad": "angular_velocity_rad_s",
    "angular_velocity_rad_s": "angle_rad",
    "force_n": "load_pressure_pa",
    "load_pressure_pa": "force_n",
}
"""Signals that determine the scale of another: its derivative or integral, or the same force."""


def _check_fit(name: str, column: Column, columns: Columns, path: Path) -> None:
    """Reject fitting a scale to a signal that does not determine it."""
    if not column.fit_to:
        return
    where = f"{path}, {name}"
    fixed_by = FITTED.get(name)
    if fixed_by is None or column.fit_to != fixed_by:
        why = f"a known scale: {f'only {fixed_by} fixes that of' if fixed_by else 'no second signal fixes that of'} {name}"
        raise BadInput(f"fit_to is {column.fit_to!r}", where, why)
    if column.fit_to not in columns or columns[column.fit_to].fit_to:
        raise BadInput(f"fit_to is {column.fit_to!r}, which has no scale", where, "that signal in the map, in its unit")


def is_topic(table: str) -> bool:
    """Return whether a table is a topic of a bag: full topic names begin with a slash, and files have no folder."""
    return table.startswith("/")


def is_contract_name(name: str) -> bool:
    """Return whether a column name belongs to the data contract."""
    return name == TIME or name in READABLE or element_of(name) is not None


def element_of(name: str) -> tuple[str, int] | None:
    """Return signal and element number, from 1, of a friction element's column; None for any other column."""
    signal, _, number = name.rpartition("_")
    known = signal in ELEMENT_SIGNALS and number.isascii() and number.isdecimal() and not number.startswith("0")
    return (signal, int(number)) if known else None
