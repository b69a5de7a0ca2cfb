"""Reading of the topics of a bag that a map of columns names, each as a table with separate rate and time stamps."""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.alignment import NANOSECONDS, SECONDS, SENT, UNIX_TIME_NS, MessageColumns
from ehls_ros.recording.bag_reader import OpenBag, damage_reported, opened
from ehls_ros.recording.bag_topic import BagTopic
from ehls_ros.recording.cdr import CdrError, Field, flatten
from ehls_ros.recording.columns import TIME, Column, ColumnMap, is_topic
from ehls_ros.recording.entries import ABSENT, FRAME, count_of, depth, label_of, numeric, split
from ehls_ros.recording.message_times import Arrivals, Clock, check_clocks, set_back
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


def read_named_topics(path: Path, given: ColumnMap) -> dict[str, Trajectory]:
    """Read the topics that a map names.

    Args:
        path: folder of the bag, or one storage file.
        given: the map: ``table`` is the topic and ``name`` the field of each column.

    Returns:
        A trajectory for each topic, with times from a common zero.

    Raises:
        BadInput: the bag cannot be read, lacks a topic or field of the map, mixes senders, or its clocks differ.
    """
    with opened(path) as bag:
        wanted = _by_topic(given, bag.where)
        topics = {name: _Topic(bag, name, columns, given.tables.get(name)) for name, columns in wanted.items()}
        bag.read({connection.id: topic.sink for topic in topics.values() for connection in topic.connections}, as_written=True)
        read, on_bag = {name: topic.messages() for name, topic in topics.items()}, bag.remarks
    zero = min(messages.first_ns for messages in read.values())
    zero = zero if zero >= UNIX_TIME_NS else 0
    trajectories = {name: topic.trajectory(read[name], zero) for name, topic in topics.items()}
    remarks = check_clocks({name: topic.clock(read[name]) for name, topic in topics.items() if not topic.counted}, str(path))
    first = next(iter(trajectories))
    prepared = trajectories[first].preparation.adding(*on_bag, *remarks)
    return trajectories | {first: replace(trajectories[first], preparation=prepared)}


class Found(NamedTuple):
    """Messages of a topic, unconverted.

    Attributes:
        type: message type.
        time: time of each message, by its stamp if there is one, from the bag's beginning, shape (n,) [s]; increasing unless
            a remark says why not.
        fields: values by the field's name in a map.
        remarks: remarks on the times, one sentence each.
    """

    type: str
    time: NDArray[np.float64]
    fields: Mapping[str, NDArray[np.float64]]
    remarks: tuple[str, ...]


def every_topic(path: Path) -> tuple[dict[str, Found], dict[str, str], list[str]]:
    """Read all numeric topics of a bag.

    Args:
        path: folder of the bag, or one storage file.

    Returns:
        The topics with numbers; the reason for each of the others; and remarks on their clocks.

    Raises:
        BadInput: the bag cannot be read.
    """
    left_out = dict[str, str]()
    with opened(path) as bag:
        sinks = {}
        for name, connections in sorted(bag.by_topic().items()):
            try:
                fields = fields_of(connections, f"{bag.where}, {name}")
                known = [f.name for f in fields if f.kind != "string" and not f.many]
                sinks[name] = _Lenient(connections, fields, known, bag.seal(name), f"{bag.where}, {name}", {}, SHOWN, True)
            except BadInput as error:
                left_out[name] = f"{error.what}; expected {error.expected}"
        bag.read({c.id: sink for sink in sinks.values() for c in sink.connections}, as_written=True)
        on_bag = list(bag.remarks)
        read = {name: columns for name, sink in sinks.items() if (columns := sink.read(left_out)) is not None}
    stamped = {name: {SECONDS, NANOSECONDS} <= columns.keys() for name, columns in read.items()}
    stamps = {name: _stamps(columns, stamped[name]) for name, columns in read.items()}
    zero = min((int(s[0]) for s in stamps.values()), default=0)
    found, clocks = dict[str, Found](), dict[str, Clock]()
    for name, columns in read.items():
        time, received = (stamps[name] - zero) / 1e9, (columns[SENT] - zero) / 1e9
        numbers, source = np.arange(len(time)) + 1, STAMP if stamped[name] else RECEIVED
        arrivals = Arrivals(time, received, numbers, zero / 1e9, source, name, f"'tables: {{{name}: {{name: {RECEIVED}}}}}'")
        clocks[name] = Clock(source, int(stamps[name][len(time) // 2]) / 1e9, float(np.median(received - time)), given=False)
        try:
            order, remarks = arrivals.arranged()
        except BadInput as error:
            order, remarks = np.arange(len(time)), (f"{error.what}; expected {error.expected}",)
        numeric_fields = {field: values[order] for field, values in _numbers(columns).items()}
        said = (*sinks[name].remarks(), *remarks)
        found[name] = Found(sinks[name].connections[0].msgtype, time[order], numeric_fields, said)
    try:
        on_bag += check_clocks(clocks, str(path))
    except BadInput as error:
        on_bag.append(f"{error.what}; expected {error.expected}")
    return found, left_out, on_bag


class _Lenient(BagTopic):
    """Topic that is left out if its messages cannot be read, such as images."""

    def __init__(self, connections: Sequence[Connection], *others: Any) -> None:
        super().__init__(connections, *others)
        self.connections = connections
        self._wrong = ""

    def add(self, stamp_ns: int, message: bytes) -> None:
        try:
            if not self._wrong:
                super().add(stamp_ns, message)
        except BadInput as error:
            self._wrong = f"{error.what}; expected {error.expected}"

    def read(self, left_out: dict[str, str]) -> MessageColumns | None:
        """Return the messages; None, with the reason, if they cannot be read or have no numbers."""
        columns: MessageColumns = {}
        try:
            columns = {} if self._wrong else in_order(self.columns())
        except BadInput as error:
            self._wrong = f"{error.what}; expected {error.expected}"
        if not self._wrong and not len(columns[SENT]):
            self._wrong = "it has no message"
        if not self._wrong and columns.keys() <= {SECONDS, NANOSECONDS, SENT, label_of(FRAME)}:
            self._wrong = f"type {self.connections[0].msgtype} has no number"
        if self._wrong:
            left_out[self.connections[0].topic] = self._wrong
        return None if self._wrong else columns


def in_order(read: MessageColumns) -> MessageColumns:
    """Sort messages by the times of reception, unless these go back because the recorder's clock was set back."""
    times = (read[SENT] - read[SENT][:1]) / 1e9
    if np.all(np.diff(times) >= 0.0) or set_back(times):
        return read
    order = np.argsort(read[SENT], kind="stable")
    return {name: values[order] for name, values in read.items()}


def _numbers(read: MessageColumns) -> dict[str, NDArray[np.float64]]:
    """Return the fields of a topic without its stamps, plain ones by frame if there are several."""
    others = (SECONDS, NANOSECONDS, SENT, label_of(FRAME))
    fields = {name: values.astype(np.float64) for name, values in read.items() if name not in others}
    labels = read.get(label_of(FRAME), np.empty(0))
    known = sorted(set(labels.tolist()))
    if not 2 <= len(known) <= SHOWN:
        return fields
    plain = {name: values for name, values in fields.items() if "[" not in name}
    by_frame = {f"{name}[{f}]": np.where(labels == f, values, np.nan) for name, values in plain.items() for f in known}
    return by_frame | {name: values for name, values in fields.items() if name not in plain}


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
    with damage_reported(where):
        try:
            return flatten(typestore_of(connection.msgdef, connection.msgtype).fielddefs, connection.msgtype)
        except CdrError as error:
            expected = "a topic of numbers, texts and sequences of them"
            if connection.msgdef.format is MessageDefinitionFormat.NONE:
                expected = (
                    f"its definition in the bag: `ros2 bag convert` to mcap adds it, where {connection.msgtype} is installed"
                )
            raise BadInput(str(error), where, expected) from None


def fields_of(connections: Sequence[Connection], where: str) -> list[Field]:
    """Return the fields of a topic's messages, which must be of one type.

    Raises:
        BadInput: the messages are of several types, or cannot be read.
    """
    types = sorted({connection.msgtype for connection in connections})
    if len(types) > 1:
        raise BadInput(f"its messages are of several types: {', '.join(types)}", where, "one type per topic")
    fields = numbers_in(connections[0], where)
    if any(numbers_in(other, where) != fields for other in connections[1:]):
        raise BadInput(f"its messages are of several versions of {types[0]}", where, "one version per topic")
    return fields


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


class _Messages(NamedTuple):
    """The messages of a topic that have a value of a mapped column.

    Attributes:
        columns: all messages.
        rows: indices of the messages used.
        stamps: their times in order of arrival; those of reception if the map names a field [ns].
        remarks: one sentence each.
    """

    columns: MessageColumns
    rows: NDArray[np.intp]
    stamps: NDArray[np.int64]
    remarks: tuple[str, ...]

    @property
    def first_ns(self) -> int:
        """Time of the first message [ns]."""
        return int(self.stamps[0])


class _Topic:
    """A topic being read."""

    def __init__(self, bag: OpenBag, name: str, columns: Mapping[str, Column], time: Column | None) -> None:
        self.where, self._bag = f"{bag.where}, {name}", bag.where
        by_topic = bag.by_topic()
        if name not in by_topic:
            what = f"topic {name} for {' and '.join(columns)} is missing (found: {', '.join(sorted(by_topic)) or 'none'})"
            raise BadInput(what, bag.where, "the name of one of its topics")
        self.connections = by_topic[name]
        fields = fields_of(self.connections, self.where)
        self._known = numeric(fields)
        stamped = {SECONDS, NANOSECONDS} <= self._known.keys()
        self._mend = time is not None and time.mend
        self._given, self._received = time is not None, f"'tables: {{{name}: {{name: {RECEIVED}}}}}' in the map"
        self._time = time.plain() if time is not None else Column(STAMP if stamped else RECEIVED)
        if self._time.name == STAMP and not stamped:
            raise BadInput(f"its messages have no {STAMP}", self.where, self._received)
        self._columns = columns
        self.counted = self._time.name not in (STAMP, RECEIVED)
        used = {**columns, TIME: self._time} if self.counted else columns
        for signal, column in used.items():
            self._check_field(signal, column)
        named = {signal: column.name for signal, column in used.items()}
        self._plain = {signal: name for signal, name in named.items() if not depth(self._known[split(name)[0]])}
        self._entries = {signal: name for signal, name in named.items() if signal not in self._plain}
        plain = {split(name)[0] for name in self._plain.values()}
        stamp = (SECONDS, NANOSECONDS) if stamped else ()
        self._framed = any(field.name == FRAME for field in fields) and bool(self._plain)
        entries = {*self._entries.values(), *([FRAME] if self._framed else [])}
        self.sink = BagTopic(self.connections, fields, {*plain, *stamp}, bag.seal(name), self.where, {}, entries, True)

    def _check_field(self, signal: str, column: Column) -> None:
        """Reject a name that is no field of a number."""
        name, keys = split(column.name)
        field = self._known.get(name)
        # A key of a plain field is the frame.
        if field is None or len(keys) not in ({depth(field)} if depth(field) else {0, 1}) or not all(keys):
            shown = (f"{f.name.replace('[]', '[0]')}{'[0]' if f.many else ''}" for f in self._known.values())
            what = f"field '{column.name}' for {signal} is missing (found: {', '.join(shown) or 'none'})"
            expected = "the name of one of its fields, with a number or a label in brackets for one of many"
            raise BadInput(what, self.where, expected)

    def messages(self) -> _Messages:
        """Return the messages with a value of a mapped column, in order of arrival.

        Raises:
            BadInput: there is none, or an entry changes its meaning from one message to another.
        """
        read = in_order(self.sink.columns())
        count = len(read[SENT])
        if not count:
            raise BadInput("there is no message", self.where, "a topic with messages")
        for signal, name in self._entries.items():
            self._check_entry(read, signal, name)
        present = {signal: read[label_of(name)] != ABSENT for signal, name in self._entries.items()}
        present |= self._framed_messages(read, count)
        signals = [signal for signal in present if signal != TIME]
        every = len(signals) < len(self._columns)
        used = np.ones(count, bool) if every else np.any([present[signal] for signal in signals], axis=0)
        used &= present.get(TIME, np.True_)
        rows, remarks = np.flatnonzero(used), self.sink.remarks()
        if len(rows) < count:
            names = " or ".join(dict.fromkeys({**self._entries, **self._plain}[signal] for signal in present))
            remarks.append(f"{count - len(rows)} of {count} messages have no {names} and are left out")
        for signal in signals:
            lacking = int(np.count_nonzero(~present[signal][rows]))
            if lacking:
                remarks.append(f"{lacking} messages have no {self._columns[signal].name}: {signal} is missing there")
        return _Messages(read, rows, _stamps(read, self._time.name == STAMP)[rows], tuple(remarks))

    def _framed_messages(self, read: MessageColumns, count: int) -> dict[str, NDArray[np.bool_]]:
        """Return the messages of the frame of each plain field, if there are several; reject a field without one then."""
        labels = read[label_of(FRAME)] if self._framed else np.full(count, "", object)
        varied = len(set(labels.tolist())) > limits.LAYOUTS
        other = np.flatnonzero(labels != labels[0]) if not varied else np.empty(0, np.intp)
        for signal, name in self._plain.items():
            field, keys = split(name)
            if keys and keys[0] not in set(labels.tolist()):
                shown = ", ".join(map(_quoted, sorted(set(labels.tolist()))[:SHOWN]))
                what = f"field '{name}' for {signal} is missing: {FRAME} is {shown}"
                raise BadInput(what, self.where, "the field, or with a frame in brackets")
            if len(other) and not keys and signal != TIME:
                first, second = (f"{_quoted(labels[k])} in message {k + 1}" for k in (0, other[0]))
                what = f"{FRAME} is {first} and {second}; {len(other)} of {count} messages differ from the first"
                such = json.dumps(f"{field}[{labels[0] or labels[other[0]]}]", ensure_ascii=False)
                raise BadInput(what, self.where, f"one sender for {signal}: a frame in brackets, such as name: {such}")
        return {signal: labels == split(name)[1][0] for signal, name in self._plain.items() if split(name)[1] and len(other)}

    def _check_entry(self, read: MessageColumns, signal: str, name: str) -> None:
        """Reject an entry that no message has, whose label changes, or that some messages are too short for."""
        labels, counts = read[label_of(name)], read[count_of(name)]
        absent = labels == ABSENT
        known = np.flatnonzero(~absent)
        by_number = all(key.isdecimal() for key in split(name)[1])
        what = f"field '{name}' for {signal}"
        if not len(known):
            if by_number:
                most = int(counts.max())
                raise BadInput(f"{what} is missing: its messages have at most {most} entries", self.where, "a number from 0 on")
            expected = f"a label of its messages; `ehls columns {shlex.quote(self._bag)}` lists them"
            raise BadInput(f"{what} is missing: no message has this label", self.where, expected)
        field, keys = split(name)
        such = f", such as name: {json.dumps(f'{field}[{labels[known[0]]}]', ensure_ascii=False)}" if len(keys) == 1 else ""
        by_label = f"a label in the brackets{such}"
        other = known[np.flatnonzero(labels[known] != labels[known[0]])]
        if len(other):
            first, second = (f"{_quoted(labels[k])} in message {k + 1}" for k in (known[0], other[0]))
            what += f" is {first} and {second}; {len(other)} of {len(known)} messages differ from the first"
            raise BadInput(what, self.where, f"one meaning: {by_label}")
        short = np.flatnonzero(absent & (counts > 0))
        if len(short) and by_number:
            what += f" is missing in {len(short)} of {len(labels)} messages, first in message {short[0] + 1}"
            meaning = by_label if labels[known[0]] else "a number that all messages have"
            raise BadInput(f"{what}, which has {counts[short[0]]} entries", self.where, meaning)

    def _times(self, read: _Messages, zero_ns: int) -> NDArray[np.float64]:
        """Return the unscaled times of the messages, from a zero [ns] unless a field of theirs holds them."""
        if self.counted:
            return self._values(read, self._time)
        return np.asarray((read.stamps - zero_ns) / 1e9, dtype=np.float64)

    def _values(self, read: _Messages, column: Column) -> NDArray[np.float64]:
        """Return the unscaled values of a column in the messages used."""
        field, keys = split(column.name)
        if depth(self._known[field]) or not keys:
            return read.columns[column.name].astype(np.float64)[read.rows]
        values = read.columns[field].astype(np.float64)[read.rows]
        return np.where(read.columns[label_of(FRAME)][read.rows] == keys[0], values, np.nan)

    def clock(self, read: _Messages) -> Clock:
        """Return the clock of the topic's times."""
        received = read.columns[SENT][read.rows]
        delay = float(np.median((received - read.stamps) / 1e9)) - self._time.offset
        return Clock(self._time.name, int(read.stamps[len(received) // 2]) / 1e9 + self._time.offset, delay, self._given)

    def trajectory(self, read: _Messages, zero_ns: int) -> Trajectory:
        """Return the topic's signals in the order of their times."""
        time = self._times(read, zero_ns)
        names, remarks = " and ".join(self._columns), list(read.remarks)
        received = (read.columns[SENT][read.rows] - zero_ns) / 1e9
        scaled, zero = self._time.scale * time + self._time.offset, 0.0 if self.counted else zero_ns / 1e9
        expected = f"the time of reception: {self._received}"
        arrivals = Arrivals(scaled, received, read.rows + 1, zero, self._time.name, self.where, expected)
        even = None
        if self._time.name == RECEIVED:
            even = sent_evenly(time) if np.all(np.diff(time) >= 0.0) else None
        if even is not None:
            remarks.append(f"sent evenly, received with delays that differ by {1e3 * float(np.std(time - even)):.2g} ms")
            time = even
            arrivals = arrivals._replace(time=self._time.scale * even + self._time.offset)
        if self._mend:
            arrivals, mended = arrivals.mended()
            remarks += mended
            time = (arrivals.time - self._time.offset) / self._time.scale
        order, found = arrivals.arranged()
        if len(order) < MIN_DISTINCT * len(time):
            what = f"its {len(time)} messages have only {len(order)} different times ({self._time.name})"
            raise BadInput(what, self.where, f"another time under 'tables' in the map, such as {{name: {RECEIVED}}}")
        chosen = {TIME: self._time, **self._columns}
        values = {signal: self._values(read, column)[order] for signal, column in self._columns.items()}
        numbers = read.rows[order] + 1
        out = assemble({TIME: time[order], **values}, chosen, self.where, lambda row: f"message {numbers[row]}")
        said = tuple(f"{names}: {remark}" for remark in (*remarks, *found))
        return Trajectory(out.time_s, out.signals, preparation=out.preparation.adding(*said))


def _quoted(label: str) -> str:
    return f"'{label}'" if label else "without a label"
