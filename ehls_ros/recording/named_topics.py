"""Reading of the topics of a bag that a map of columns names, each as a table with separate rate and time stamps."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from ehls_ros.errors import BadInput
from ehls_ros.recording.alignment import NANOSECONDS, SECONDS, SENT, UNIX_TIME_NS, MessageColumns
from ehls_ros.recording.bag_reader import OpenBag, damage_reported, opened
from ehls_ros.recording.bag_topic import BagTopic
from ehls_ros.recording.cdr import CdrError, Field, flatten
from ehls_ros.recording.columns import TIME, Column, ColumnMap, is_topic
from ehls_ros.recording.table import assemble
from ehls_ros.recording.times import sent_evenly
from ehls_ros.recording.typestore import typestore_of
from ehls_ros.trajectory import Trajectory

STAMP, RECEIVED = "header.stamp", "received"
"""Sources of a topic's times: the stamp in the header, or the time of reception by the recorder."""

MIN_DISTINCT = 0.5
"""Minimum fraction of a topic's messages with distinct times; below it, the stamps are not set."""

SHOWN = 16
"""Maximum number of entries of a sequence that are shown."""

ENTRY = re.compile(r"(?P<field>.+)\[(?P<number>[0-9]{1,6})\]\Z")
"""One entry of a sequence, such as ``position[0]``."""


def read_named_topics(path: Path, given: ColumnMap) -> dict[str, Trajectory]:
    """Read the topics that a map names.

    Args:
        path: folder of the bag, or one storage file.
        given: the map: ``table`` is the topic and ``name`` the field of each column.

    Returns:
        A trajectory for each topic, with times from a common zero.

    Raises:
        BadInput: the bag cannot be read, or lacks a topic or field of the map.
    """
    with opened(path) as bag:
        wanted = _by_topic(given, bag.where)
        topics = {name: _Topic(bag, name, columns, given.tables.get(name)) for name, columns in wanted.items()}
        bag.read({connection.id: topic.sink for topic in topics.values() for connection in topic.connections})
        read = {name: topic.sink.columns() for name, topic in topics.items()}
    stamps = {name: topic.stamps(read[name]) for name, topic in topics.items()}
    first = min(int(s[0]) for s in stamps.values())
    zero = first if first >= UNIX_TIME_NS else 0
    return {name: topic.trajectory(read[name], (stamps[name] - zero) / 1e9) for name, topic in topics.items()}


class Found(NamedTuple):
    """Messages of a topic, unconverted.

    Attributes:
        type: message type.
        time: time of each message, by its stamp if there is one, from the bag's beginning, shape (n,) [s].
        fields: values by the field's name in a map.
    """

    type: str
    time: NDArray[np.float64]
    fields: Mapping[str, NDArray[np.float64]]


def every_topic(path: Path) -> dict[str, Found]:
    """Read all numeric topics of a bag.

    Args:
        path: folder of the bag, or one storage file.

    Raises:
        BadInput: the bag cannot be read.
    """
    with opened(path) as bag:
        sinks = {}
        for name, connections in sorted(bag.by_topic().items()):
            with suppress(BadInput):
                fields = numbers_in(connections[0], bag.where)
                known = [f.name for f in fields if f.kind != "string"]
                sinks[name] = _Lenient(connections, fields, known, bag.seal(name), f"{bag.where}, {name}")
        bag.read({c.id: sink for sink in sinks.values() for c in sink.connections})
        read = {name: sink.columns() for name, sink in sinks.items() if sink.sound}
    stamped = {name: {SECONDS, NANOSECONDS} <= columns.keys() for name, columns in read.items()}
    stamps = {name: _stamps(columns, stamped[name]) for name, columns in read.items() if len(columns[SENT])}
    zero = min((int(s[0]) for s in stamps.values()), default=0)
    return {
        name: Found(sinks[name].connections[0].msgtype, (s - zero) / 1e9, _numbers(read[name])) for name, s in stamps.items()
    }


class _Lenient(BagTopic):
    """Topic that is skipped if its messages cannot be read, such as images."""

    def __init__(self, connections: Sequence[Connection], *others: Any) -> None:
        super().__init__(connections, *others)
        self.connections = connections
        self.sound = True

    def add(self, stamp_ns: int, message: bytes) -> None:
        try:
            if self.sound:
                super().add(stamp_ns, message)
        except BadInput:
            self.sound = False


def _numbers(read: MessageColumns) -> dict[str, NDArray[np.float64]]:
    """Return the fields of a topic without its stamps, each entry of a sequence separately."""
    out = {}
    for name, values in read.items():
        if name in (SECONDS, NANOSECONDS, SENT):
            continue
        if values.ndim == 1:
            out[name] = values.astype(np.float64)
        else:
            out |= {f"{name}[{i}]": values[:, i].astype(np.float64) for i in range(min(values.shape[1], SHOWN))}
    return out


def _stamps(read: MessageColumns, stamped: bool) -> NDArray[np.int64]:
    """Return the time of each message, in order of arrival [ns]."""
    if not stamped:
        return read[SENT].astype(np.int64)
    return read[SECONDS].astype(np.int64) * 10**9 + read[NANOSECONDS].astype(np.int64)


def numbers_in(connection: Connection, where: str) -> list[Field]:
    """Return the fields of a topic's messages as defined in the bag.

    Raises:
        BadInput: the definition is invalid, or has fields of a kind that is not read.
    """
    try:
        with damage_reported(where):
            return flatten(typestore_of(connection.msgdef, connection.msgtype).fielddefs, connection.msgtype)
    except CdrError as error:
        raise BadInput(str(error), where, "a topic of numbers, texts and sequences of them") from None


def _by_topic(given: ColumnMap, where: str) -> dict[str, dict[str, Column]]:
    """Return the columns of each topic by their signals."""
    out: dict[str, dict[str, Column]] = {}
    for name, column in given.columns.items():
        if name == TIME:
            expected = f"under 'tables', for each topic: '/topic: {{name: {RECEIVED}}}' or a field; {STAMP} needs no entry"
            raise BadInput(f"{TIME} is mapped, but each topic of a bag has separate times", where, expected)
        if not is_topic(column.table):
            raise BadInput(f"no topic is named for {name}", where, "'table: /topic' beside its name in the map")
        if column.expression:
            raise BadInput(f"expression is {column.expression!r} for {name}", where, "the name of one field, as this is a bag")
        out.setdefault(column.table, {})[name] = column.plain()
    if not out:
        raise BadInput("the map names no column", where, "an entry like 'force_n: {table: /topic, name: data}'")
    return out


class _Topic:
    """A topic being read."""

    def __init__(self, bag: OpenBag, name: str, columns: Mapping[str, Column], time: Column | None) -> None:
        self.where = f"{bag.where}, {name}"
        by_topic = bag.by_topic()
        if name not in by_topic:
            what = f"topic {name} for {' and '.join(columns)} is missing (found: {', '.join(sorted(by_topic)) or 'none'})"
            raise BadInput(what, bag.where, "the name of one of its topics")
        self.connections = by_topic[name]
        fields = numbers_in(self.connections[0], self.where)
        self._known = {f.name: f for f in fields if f.kind != "string"}
        stamped = {SECONDS, NANOSECONDS} <= self._known.keys()
        self._time = time.plain() if time is not None else Column(STAMP if stamped else RECEIVED)
        if self._time.name == STAMP and not stamped:
            raise BadInput(
                f"its messages have no {STAMP}", self.where, f"'tables: {{{name}: {{name: {RECEIVED}}}}}' in the map"
            )
        self._columns = columns
        used = {signal: self._field(signal, column) for signal, column in columns.items()}
        own = () if self._time.name in (STAMP, RECEIVED) else (self._field(TIME, self._time),)
        stamp = (SECONDS, NANOSECONDS) if stamped else ()
        self.sink = BagTopic(self.connections, fields, {*used.values(), *own, *stamp}, bag.seal(name), self.where)

    def _field(self, signal: str, column: Column) -> str:
        """Return the field that contains a column."""
        match = ENTRY.match(column.name)
        name = match["field"] if match else column.name
        field = self._known.get(name)
        if field is None or field.many != bool(match):
            found = ", ".join(f"{f.name}[0]" if f.many else f.name for f in self._known.values()) or "none"
            what = f"field '{column.name}' for {signal} is missing (found: {found})"
            raise BadInput(what, self.where, "the name of one of its fields, with a number in brackets for one of many")
        return name

    def stamps(self, read: MessageColumns) -> NDArray[np.int64]:
        """Return the time of each message, in order of arrival [ns]; that of reception if the map names a field."""
        if not len(read[SENT]):
            raise BadInput("there is no message", self.where, "a topic with messages")
        return _stamps(read, self._time.name == STAMP)

    def trajectory(self, read: MessageColumns, stamps: NDArray[np.float64]) -> Trajectory:
        """Return the topic's signals in the order of their times."""
        own = self._time.name not in (STAMP, RECEIVED)
        time = self._values(read, TIME, self._time) if own else stamps
        names, remarks = " and ".join(self._columns), list[str]()
        even = sent_evenly(time) if self._time.name == RECEIVED else None
        if even is not None:
            remarks.append(
                f"{names}: sent evenly, received with delays that differ by {1e3 * float(np.std(time - even)):.2g} ms"
            )
            time = even
        order = np.argsort(time, kind="stable")
        order = order[np.diff(time[order], prepend=-np.inf) > 0.0]
        repeated = len(time) - len(order)
        if len(order) < MIN_DISTINCT * len(time):
            what = f"its {len(time)} messages have only {len(order)} different times ({self._time.name})"
            raise BadInput(what, self.where, f"another time under 'tables' in the map, such as {{name: {RECEIVED}}}")
        if repeated:
            remarks.append(f"{repeated} messages of {names} repeat a time and are left out")
        values = {signal: self._values(read, signal, column)[order] for signal, column in self._columns.items()}
        chosen = {TIME: self._time, **self._columns}
        out = assemble({TIME: time[order], **values}, chosen, self.where, lambda row: f"message {order[row] + 1}")
        return Trajectory(out.time_s, out.signals, preparation=out.preparation.adding(*remarks))

    def _values(self, read: MessageColumns, signal: str, column: Column) -> NDArray[np.float64]:
        match = ENTRY.match(column.name)
        if not match:
            return read[column.name].astype(np.float64)
        entries, number = read[match["field"]], int(match["number"])
        if number >= entries.shape[1]:
            what = f"field '{column.name}' for {signal} is missing: its messages have at most {entries.shape[1]} entries"
            raise BadInput(what, self.where, "a number from 0 on")
        return np.asarray(entries[:, number], dtype=np.float64)
