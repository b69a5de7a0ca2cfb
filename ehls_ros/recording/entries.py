"""Single values of the sequences in messages, chosen by number, ``position[0]``, or by label, ``position[rod]``.

The entries of a sequence are labelled by the sequence of texts of equal length beside it, such as ``name[]`` of a
JointState, or by the texts within each entry, such as ``child_frame_id`` of a transform. Senders differ in the order and
number of entries, so a number can mean different things in the messages of one topic.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.recording.cdr import Alike, CdrError, Field, Place, by_layout

KEY = re.compile(r"\[([^\]]*)\]")

ABSENT = "\0absent"
"""Label of an entry that a message does not have; a text of CDR has no null."""

FRAME = "header.frame_id"
"""Text that labels the plain fields of a message."""

LONGEST_LABEL = 255
"""Longest label used in a name [characters]."""


def split(name: str) -> tuple[str, tuple[str, ...]]:
    """Return the field and the keys of an entry: ``transforms[].rotation.x`` and ``rod`` of ``transforms[rod].rotation.x``."""
    return KEY.sub("[]", name).removesuffix("[]"), tuple(KEY.findall(name))


def label_of(name: str) -> str:
    """Return the name of the column with the labels of an entry."""
    return f"label of {name}"


def count_of(name: str) -> str:
    """Return the name of the column with the number of entries from which one is chosen."""
    return f"number of {name}"


def numeric(fields: Sequence[Field]) -> dict[str, Field]:
    """Return the numeric fields by name, with those in the entries of sequences."""
    found: dict[str, Field] = {}
    for field in fields:
        found |= numeric(field.parts) if field.parts else {} if field.kind == "string" else {field.name: field}
    return found


def depth(field: Field) -> int:
    """Return the number of keys of one value of a field."""
    return field.name.count("[]") + field.many


def decode_entries(messages: Sequence[bytes], fields: Sequence[Field], wanted: Collection[str]) -> dict[str, NDArray[Any]]:
    """Read single entries of sequences.

    Args:
        messages: n serialized messages of one type.
        fields: the fields of that type.
        wanted: names of the entries.

    Returns:
        For each entry its values, shape (n,), NaN where a message has none; as :func:`label_of` it, its labels, empty if it has
        none and :data:`ABSENT` where a message has no such entry; as :func:`count_of` it, the lengths of the sequence.

    Raises:
        CdrError: the messages are not of this type, a label occurs twice in a message, or the labels vary too much.
    """
    out: dict[str, NDArray[Any]] = {}
    for name in wanted:
        out[name], out[label_of(name)] = np.full(len(messages), np.nan), np.full(len(messages), ABSENT, object)
        out[count_of(name)] = np.zeros(len(messages), np.int64)
    for alike in by_layout(messages, fields, _texts(fields)) if wanted else ():
        labels = _Labels(alike)
        for name in wanted:
            found = list(labels.matches(*split(name)))
            out[count_of(name)][alike.which] = labels.count(split(name)[0])
            if len(found) > 1:
                raise CdrError(f"'{name}' is ambiguous: it may be {' or '.join(entry.by_label for entry in found[:2])}")
            for entry in found:
                out[name][alike.which] = alike.values(entry.place)[:, entry.offset]
                out[label_of(name)][alike.which] = entry.label
    return out


def frames(messages: Sequence[bytes], fields: Sequence[Field]) -> dict[str, NDArray[Any]]:
    """Read the frames in the headers: the senders of one topic often differ in them alone.

    Args:
        messages: n serialized messages of one type.
        fields: the fields of that type.

    Returns:
        The texts as :func:`label_of` :data:`FRAME`, shape (n,); empty texts if they vary too much to be labels; nothing if the
        type has no header.
    """
    if not any(field.name == FRAME and not field.many for field in fields):
        return {}
    found = np.full(len(messages), "", object)
    try:
        for alike in by_layout(messages, fields, (FRAME,)):
            [text] = (alike.text(place) for place in alike.places if place.field.name == FRAME)
            found[alike.which] = text
    except CdrError:
        found[:] = ""
    return {label_of(FRAME): found}


def every_entry(messages: Sequence[bytes], fields: Sequence[Field], most: int) -> dict[str, NDArray[Any]]:
    """Read the entries of all sequences, named by label where there are labels, with NaN where a message has none.

    Args:
        messages: n serialized messages of one type.
        fields: the fields of that type.
        most: maximum number of entries of one sequence.
    """
    out: dict[str, NDArray[Any]] = {}
    for alike in by_layout(messages, fields, _texts(fields)):
        labels = _Labels(alike)
        for field in numeric(fields).values():
            entries = list(labels.first(field, most)) if depth(field) else []
            repeated = {name for name, times in Counter(entry.by_label for entry in entries).items() if times > 1}
            for entry in entries:
                name = entry.by_number if entry.by_label in repeated else entry.by_label
                column = out.setdefault(name, np.full(len(messages), np.nan))
                column[alike.which] = alike.values(entry.place)[:, entry.offset]
    return out


class _Level(NamedTuple):
    """One key of an entry: its number in the sequence, and the texts that label it."""

    number: int
    texts: tuple[str, ...]

    @property
    def label(self) -> str:
        return "/".join(filter(None, self.texts))

    @property
    def key(self) -> str:
        """Label as in a map, in quotes if it is a number; the number where there is no label that a map can name."""
        if not self.label or "]" in self.label or len(self.label) > LONGEST_LABEL:
            return str(self.number)
        return f'"{self.label}"' if self.label.isdecimal() else self.label

    def answers(self, key: str) -> bool:
        return self.number == int(key) if key.isdecimal() else key.strip('"') in (*self.texts, self.label)


class _Entry(NamedTuple):
    place: Place
    offset: int
    levels: tuple[_Level, ...]

    @property
    def label(self) -> str:
        return ", ".join(filter(None, (level.label for level in self.levels)))

    @property
    def by_number(self) -> str:
        return self._named([str(level.number) for level in self.levels])

    @property
    def by_label(self) -> str:
        return self._named([level.key for level in self.levels])

    def _named(self, keys: Sequence[str]) -> str:
        name = self.place.field.name + "[]" * self.place.field.many
        return name.replace("[]", "[{}]").format(*keys)


class _Labels:
    """Labels of the entries in messages of equal layout and texts."""

    def __init__(self, alike: Alike) -> None:
        self._places: dict[str, list[Place]] = defaultdict(list)
        self._lengths: dict[tuple[str, tuple[int, ...]], int] = defaultdict(int)
        self._within: dict[tuple[str, tuple[int, ...]], list[str]] = defaultdict(list)
        """Texts of an entry, by its sequence and number."""
        self._beside: dict[str, dict[tuple[str, tuple[int, ...]], list[str]]] = defaultdict(lambda: defaultdict(list))
        """Sequences of texts by the path that contains them, each by its name and the number of the enclosing entry."""
        for place in alike.places:
            name, index = place.field.name, place.within
            self._places[name].append(place)
            parts = name.split("[]")
            for level in range(len(index)):
                key = "[]".join(parts[: level + 1]), index[:level]
                self._lengths[key] = max(self._lengths[key], index[level] + 1)
            if place.field.kind != "string" or not index:
                continue
            if parts[-1]:
                self._within["[]".join(parts[:-1]), index].append(alike.text(place))
            else:
                sequence = "[]".join(parts[:-1])
                self._beside[_parent(sequence)][sequence, index[:-1]].append(alike.text(place))

    def count(self, field: str) -> int:
        """Return the number of values of a field."""
        return sum(place.length for place in self._places[field])

    def matches(self, field: str, keys: Sequence[str]) -> Iterator[_Entry]:
        """Yield the entries of a field that answer to some keys."""
        for place in self._places[field]:
            inner = keys[len(place.within) :]
            outer = self._outer(place)
            if not all(level.answers(key) for level, key in zip(outer, keys, strict=False)):
                continue
            if not inner:
                yield _Entry(place, 0, outer)
            elif inner[0].isdecimal():
                numbers = [int(inner[0])] if int(inner[0]) < place.length else []
                yield from (self._entry(place, outer, number) for number in numbers)
            else:
                for number in range(place.length if self._beside else 0):
                    entry = self._entry(place, outer, number)
                    if entry.levels[-1].answers(inner[0]):
                        yield entry

    def first(self, field: Field, most: int) -> Iterator[_Entry]:
        """Yield the first entries of a field."""
        for place in self._places[field.name]:
            if most <= 0:
                return
            outer = self._outer(place)
            for number in range(min(most, place.length)):
                yield self._entry(place, outer, number) if field.many else _Entry(place, 0, outer)
            most -= place.length

    def _outer(self, place: Place) -> tuple[_Level, ...]:
        parts = place.field.name.split("[]")
        sequences = ["[]".join(parts[: level + 1]) for level in range(len(place.within))]
        return tuple(
            self._level(sequence, place.within[: level + 1], self._lengths[sequence, place.within[:level]], own=True)
            for level, sequence in enumerate(sequences)
        )

    def _entry(self, place: Place, outer: tuple[_Level, ...], number: int) -> _Entry:
        level = self._level(place.field.name, (*place.within, number), place.length, own=False)
        return _Entry(place, number, (*outer, level))

    def _level(self, sequence: str, index: tuple[int, ...], length: int, *, own: bool) -> _Level:
        """Return the labels of an entry; ``own``: it is a message, labelled only by texts in it or beside its sequence."""
        texts = list(self._within.get((sequence, index), ())) if own else []
        parent = _parent(sequence)
        while True:
            beside = self._beside.get(parent, {})
            enclosing = index[: parent.count("[]")]
            named = [found[index[-1]] for (_, within), found in beside.items() if within == enclosing and len(found) == length]
            if named or not parent or own:
                return _Level(index[-1], (*named, *texts))
            parent = _parent(parent.removesuffix("."))


def _parent(path: str) -> str:
    """Return the path that contains a field, with its dot; empty at the top."""
    return path[: path.rfind(".") + 1]


def _texts(fields: Sequence[Field]) -> set[str]:
    """Return the names of the texts that may label entries: those in sequences."""
    found = set[str]()
    for field in fields:
        found |= {part.name for part in field.parts if part.kind == "string" and not part.parts} | _texts(field.parts)
    return found
