"""Columns in the variables of a MATLAB file: vectors, matrices, and structures of Simulink, ControlDesk and Modelica tools."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import TIME, is_contract_name
from ehls_ros.recording.headers import recognised
from ehls_ros.recording.table import TIMES_IN_SECONDS

MAX_COLUMNS = 1000
"""Largest number of columns of a matrix that are listed; a larger one is no table [1]."""

NUMERIC = "fiub"
"""Kinds of numbers, as of numpy."""

NOT_NUMERIC: Mapping[str, str] = {"U": "text", "c": "complex numbers", "V": "complex numbers"}
"""Designation of other kinds."""

OF_RECORDING = frozenset({"X", "Y", "Description", "RTProgram", "Capture"})
"""Fields of a recording of ControlDesk."""

OF_SIMULINK = frozenset({"time", "signals", "blockName"})
"""Fields of a structure with time of Simulink."""

ARRAYS_OF: Mapping[str, str] = {
    "timeseries": "{0}.Time and {0}.Data",
    "timetable": "seconds({0}.Properties.RowTimes) and {0}.Variables",
    "table": "table2struct({0}, 'ToScalar', true)",
    "datetime": "posixtime({0})",
    "duration": "seconds({0})",
    "Simulink.SimulationData.Dataset": "{0}{{1}}.Values.Time and {0}{{1}}.Values.Data",
    "Simulink.SimulationOutput": "{0}.tout and {0}.yout",
}
"""Expressions that convert MATLAB objects to arrays, by class."""

UNIT = re.compile(r"\[([^\]|]+)(?:\|[^\]]*)?\]\s*\Z")
"""Unit at the end of a description of a Modelica variable, before the unit for display."""


class Leaf:
    """Variable or field that is not a structure.

    Attributes:
        shape: its dimensions, without those of length one.
        kind: kind of its elements, as of numpy.
        text: content of a text; of an object, its name.
        wrong: reason why it has no numbers; empty for an array.
    """

    def __init__(
        self,
        shape: Sequence[int],
        kind: str,
        read: Callable[[], NDArray[Any]] = lambda: np.empty(0),
        text: str = "",
        wrong: str = "",
    ) -> None:
        """Store the properties; ``read`` returns the array."""
        self.shape, self.kind, self.text, self.wrong = tuple(shape), kind, text, wrong
        self._read = read

    @classmethod
    def of_object(cls, name: str, kind: str) -> "Leaf":
        """Return a MATLAB object, whose content is not documented."""
        instead = ARRAYS_OF.get(kind, "the numeric properties of {0}").format(name)
        return cls((0,), "O", text=name, wrong=f"a MATLAB object ({kind}): {instead}, saved as arrays")

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(np.prod(self.shape, dtype=np.int64))

    @cached_property
    def array(self) -> NDArray[Any]:
        """The elements."""
        return self._read()


Node = Leaf | Mapping[str, "Node"] | Sequence["Node"]
"""Variable: an array, a structure, or a structure array."""


class Source(NamedTuple):
    """Origin of a column: an array, or a slice of a matrix."""

    leaf: Leaf
    number: int | None = None
    axis: int = 1
    sign: int = 1
    rows: NDArray[np.intp] | None = None

    @property
    def length(self) -> int:
        """Number of rows."""
        if self.rows is not None:
            return len(self.rows)
        return self.leaf.shape[0] if self.number is None else self.leaf.shape[1 - self.axis]

    def values(self) -> NDArray[Any]:
        """Return the values."""
        values = self.leaf.array if self.number is None else self.leaf.array.take(self.number, axis=self.axis)
        if self.rows is not None:
            values = values[self.rows]
        return values if self.sign == 1 else -values


@dataclass
class Layout:
    """Columns of a file.

    Attributes:
        sources: by name.
        units: by name, if stated.
        time_of: name of the time column of each column, if stated.
        wrong: reason by the name of a column without numbers.
        remarks: on the layout, one sentence each.
        shapes: remark on the shape of each matrix, by its name.
        aliases: names of columns by their paths, for columns with a name of their own.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    time_of: dict[str, str] = field(default_factory=dict)
    wrong: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    shapes: dict[str, str] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)

    def add(self, path: str, leaf: Leaf, label: str = "", unit: str = "", time: str = "") -> None:
        """Add an array.

        Args:
            path: expression for the array in MATLAB.
            leaf: the array.
            label: its name, if it has one; the columns are named by it, and the path remains an alias.
            unit: its unit, if stated.
            time: name of its time column, if stated; used for columns of that length.
        """
        name = label if label and label not in self.sources else path
        for column, source in self._columns(name, leaf, self.sources[time].length if time in self.sources else -1):
            self.sources[column] = source
            if unit:
                self.units[column] = unit
            if time in self.sources and self.sources[time].length == source.length and column not in self.wrong:
                self.time_of[column] = time
            if name != path:
                self.aliases[path + column.removeprefix(name)] = column

    def _columns(self, name: str, leaf: Leaf, rows: int) -> Iterator[tuple[str, Source]]:
        """Yield the columns of an array: one, or those of a matrix, with samples along the given or the longer dimension."""
        shown = " x ".join(map(str, leaf.shape))
        if leaf.wrong or leaf.kind not in NUMERIC:
            self.wrong[name] = leaf.wrong or NOT_NUMERIC.get(leaf.kind, "cells, a function or an object")
        elif len(leaf.shape) == 2 and not is_contract_name(name) and min(leaf.shape) <= MAX_COLUMNS:
            axis = 1 if leaf.shape[0] == (rows if rows in leaf.shape else max(leaf.shape)) else 0
            count = leaf.shape[axis]
            self.shapes[name] = (
                f"{name} is {shown}: {name} 1 to {name} {count} are its columns of {leaf.shape[1 - axis]} values"
            )
            yield from ((f"{name} {k + 1}", Source(leaf, k, axis)) for k in range(count))
            return
        elif len(leaf.shape) > 1 and not is_contract_name(name):
            self.wrong[name] = f"its shape is {shown}"
        yield name, Source(leaf)


def objects_only(layout: Layout) -> list[str]:
    """Return the objects of a file that has numbers in no other variable; empty if it has other columns."""
    objects = [f"{name}: {source.leaf.wrong.partition('(')[2].partition(')')[0]}" for name, source in layout.sources.items()]
    others = [source for source in layout.sources.values() if not source.leaf.wrong.startswith("a MATLAB object")]
    return objects if objects and not others else []


def layout_of(tree: Node) -> Layout:
    """Return the columns of a file's variables.

    Args:
        tree: the variables by name.
    """
    layout = Layout()
    assert isinstance(tree, Mapping)  # noqa: S101 - the variables of a file have names
    for name, node in tree.items():
        _walk(layout, name, node)
    _with_separate_times(layout)
    return layout


def _with_separate_times(layout: Layout) -> None:
    """Find the times of structures such as ``fast.t`` and ``slow.t``; a single one is left to the map."""
    taken = {*layout.time_of, *layout.time_of.values(), *layout.wrong}
    fields: dict[str, list[str]] = {}
    times: dict[str, dict[str, str]] = {}
    for name in layout.sources:
        path, _, last = name.rpartition(".")
        if path and name not in taken:
            fields.setdefault(path, []).append(name)
            unit = _time_unit(last)
            if unit is not None:
                times.setdefault(path, {})[name] = unit
    certain = {path: found for path, found in times.items() if len(found) == 1}
    if len(certain) < 2:
        return
    without = list[str]()
    for path, found in certain.items():
        [(time, unit)] = found.items()
        rows = layout.sources[time].length
        layout.time_of |= {name: time for name in fields[path] if name != time and layout.sources[name].length == rows}
        if unit:
            layout.units[time] = unit
        else:
            without.append(time)
    if without:
        layout.remarks.append(f"{', '.join(without)}: {TIMES_IN_SECONDS}")


def _time_unit(name: str) -> str | None:
    """Return the unit that a name of times states, empty if none; None for another name."""
    for unit in ("", "s"):
        [header] = recognised([name], {name: unit})
        if header.signal == TIME and header.certainty in ("contract", "stated"):
            return "" if unit else header.unit or "s"
    return None


def _walk(layout: Layout, path: str, node: Node) -> None:
    if isinstance(node, Leaf):
        layout.add(path, node)
    elif isinstance(node, Mapping):
        added = _recording(layout, path, node) or _with_time(layout, path, node)
        for name, member in node.items():
            if name not in added:
                _walk(layout, f"{path}.{name}", member)
    else:
        for k, member in enumerate(node):
            _walk(layout, f"{path}({k + 1})", member)


def _with_time(layout: Layout, path: str, node: Mapping[str, Node]) -> frozenset[str]:
    """Add a structure with time of Simulink; return the names of its fields, none if it is another structure."""
    time, signals = node.get("time"), _elements(node.get("signals"), "values")
    if not isinstance(time, Leaf) or not signals:
        return frozenset()
    own = f"{path}.time"
    layout.add(own, time)
    layout.units[own] = "s"
    for k, signal in enumerate(signals):
        at = f"{path}.signals({k + 1})" if len(signals) > 1 else f"{path}.signals"
        layout.add(f"{at}.values", _leaf(signal, "values"), _text(signal, "label"), time=own)
    return OF_SIMULINK


def _recording(layout: Layout, path: str, node: Mapping[str, Node]) -> frozenset[str]:
    """Add a recording of ControlDesk; return the names of its fields, none if it is another structure.

    X has the times of each raster, and Y the signals, each with the raster's name or the index of its X.
    """
    rasters, signals = _elements(node.get("X"), "Data"), _elements(node.get("Y"), "Data")
    if not rasters or not signals or not all(isinstance(signal.get("Name"), Leaf) for signal in signals):
        return frozenset()
    times = list[str]()
    for k, raster in enumerate(rasters):
        times.append(f"{path}.X({k + 1}).Data" if len(rasters) > 1 else f"{path}.X.Data")
        layout.add(times[-1], _leaf(raster, "Data"))
        layout.units[times[-1]] = _text(raster, "Unit") or "s"
    by_name = {_text(raster, "Raster"): times[k] for k, raster in enumerate(rasters)}
    count = Counter(_text(signal, "Name") for signal in signals)
    for k, signal in enumerate(signals):
        at = f"{path}.Y({k + 1}).Data" if len(signals) > 1 else f"{path}.Y.Data"
        index = next((_leaf(signal, key) for key in ("XIndex", "Xindex") if key in signal), None)
        number = int(index.array.ravel()[0]) if index is not None and index.kind in NUMERIC and index.size == 1 else 1
        time = by_name.get(_text(signal, "Raster"), times[number - 1] if 1 <= number <= len(times) else "")
        name = _text(signal, "Name")
        label = name if count[name] == 1 or not _text(signal, "Path") else f"{_text(signal, 'Path')}/{name}"
        layout.add(at, _leaf(signal, "Data"), label, _text(signal, "Unit"), time)
    return OF_RECORDING


def _elements(node: Node | None, key: str) -> list[Mapping[str, Node]]:
    """Return the elements of a structure array, all with an array under a key; empty if it is none."""
    elements = [node] if isinstance(node, Mapping) else [] if node is None or isinstance(node, Leaf) else list(node)
    whole = all(isinstance(element, Mapping) and isinstance(element.get(key), Leaf) for element in elements)
    return [element for element in elements if isinstance(element, Mapping)] if whole else []


def _leaf(structure: Mapping[str, Node], name: str) -> Leaf:
    found = structure.get(name)
    return found if isinstance(found, Leaf) else Leaf((0,), "O")


def _text(structure: Mapping[str, Node], name: str) -> str:
    return _leaf(structure, name).text.strip()


# --- Modelica ----------------------------------------------------------------------------------


def modelica_layout(variables: Mapping[str, Any], where: str) -> Layout:
    """Return the columns of a result file of Dymola or OpenModelica.

    The matrix ``dataInfo`` has the block, and the column, negative for a changed sign, of each variable in ``name``; block 0 is
    the time. In the transposed form, all matrices are stored by columns. Block 1 has the parameters. A short form has only
    ``names`` and ``data``, which begins with the time.

    Args:
        variables: the file's variables, not squeezed.
        where: the file, for errors.

    Raises:
        BadInput: it is another kind of file.
    """
    kind, *_, form = [str(line).strip("\0 ") for line in (*variables["Aclass"], "", "", "")][:4]
    if kind != "Atrajectory":
        raise BadInput(f"it is a Modelica file of kind {kind!r}", where, "the result of a simulation (Atrajectory)")
    if "names" in variables:
        blocks = {2: np.asarray(variables["data"])}
        info = [(2 if k else 0, k + 1) for k in range(blocks[2].shape[1])]
        names, texts = _lines(variables["names"], transposed=False, count=len(info)), [""] * len(info)
    else:
        transposed = form == "binTrans"
        matrix = np.asarray(variables["dataInfo"]).T if transposed else np.asarray(variables["dataInfo"])
        info = [(int(block), int(column)) for block, column, *_ in matrix]
        names = _lines(variables["name"], transposed, len(info))
        texts = _lines(variables.get("description", ()), transposed, len(info))
        found = {block: variables.get(f"data_{block}") for block in sorted({2, *(block for block, _ in info)} - {0, 1})}
        blocks = {block: m.T if transposed else m for block, m in found.items() if m is not None}
    layout = Layout()
    time = next((names[k] for k, (block, _) in enumerate(info) if block == 0), "time")
    for block, values in blocks.items():
        if not values.size:
            continue
        # A variable changes at an event, between two rows of one time; the second holds from then on.
        rows = np.flatnonzero(np.diff(values[:, 0], append=np.inf) > 0.0)
        leaf, own = Leaf(values.shape, values.dtype.kind, partial(np.asarray, values)), f"{time} {block}" if block > 2 else time
        layout.sources[own], layout.units[own] = Source(leaf, 0, rows=rows), "s"
        if len(values) > len(rows):
            layout.remarks.append(f"{len(values) - len(rows)} rows before events, which repeat a time, are left out")
        for name, text, (number, column) in zip(names, texts, info, strict=True):
            if number == block and 1 <= abs(column) <= values.shape[1]:
                layout.sources[name] = Source(leaf, abs(column) - 1, sign=1 if column > 0 else -1, rows=rows)
                layout.time_of[name] = own
                unit = UNIT.search(text)
                if unit:
                    layout.units[name] = unit[1]
    parameters = sum(block == 1 for block, _ in info)
    if parameters:
        layout.remarks.append(f"{parameters} parameters and constants are left out")
    return layout


def _lines(text: Any, transposed: bool, count: int) -> list[str]:
    """Return the lines of a matrix of characters, which are its columns in the transposed form."""
    lines = [str(line) for line in np.atleast_1d(np.asarray(text)).ravel()]
    if transposed:
        lines = ["".join(letters) for letters in zip(*(line.ljust(count, "\0")[:count] for line in lines), strict=True)]
    return [line.partition("\0")[0].strip() for line in [*lines, *[""] * count][:count]]
