"""Events of a run, from its bag: parameter changes, node transitions, trips and other changes of the safety gate."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput
from ehls_ros.recording import limits
from ehls_ros.recording.alignment import NANOSECONDS, SECONDS, SENT, UNIX_TIME_NS, MessageColumns
from ehls_ros.recording.bag_reader import OpenBag, damage_reported, namespace_of, opened, read_topics
from ehls_ros.recording.topics import (
    DIAGNOSTICS,
    DRIVING,
    LOADER_STATE,
    OF_GATE,
    PARAMETER_EVENTS,
    TRANSITION_EVENT,
    known_topic,
    transition_topic,
)
from ehls_ros.recording.typestore import typestore

VALUES: Mapping[int, str] = MappingProxyType(
    {
        1: "bool_value",
        2: "integer_value",
        3: "double_value",
        4: "string_value",
        5: "byte_array_value",
        6: "bool_array_value",
        7: "integer_array_value",
        8: "double_array_value",
        9: "string_array_value",
    }
)
"""Field of a ParameterValue by its type, as numbered in rcl_interfaces."""

PRIMARY_STATES = range(1, 5)
"""Primary lifecycle states, as numbered in lifecycle_msgs; the others are transitions in progress."""


class Event(NamedTuple):
    """An intervention in a run, or an incident.

    Attributes:
        time_s: time of the preceding snapshot on the time base of the bag's trajectory [s]; None before the first.
        node: affected node, without the run's namespace.
        what: description.
    """

    time_s: float | None
    node: str
    what: str


def read_events(path: Path) -> list[Event]:
    """Read the events of the run in a bag.

    Args:
        path: folder of the bag, or one storage file.

    Returns:
        The events in the order of sending: parameter changes with the previous value; transitions of lifecycle nodes; each
        change of the gate's state; new warnings and errors of the nodes.

    Raises:
        BadInput: the bag cannot be read, or has no ``loader_state``.
    """
    with opened(path) as bag:
        namespace = namespace_of(bag)
        snapshots = read_topics(bag, ())[LOADER_STATE.name]
        texts = _EventTexts(namespace)
        events = [
            (stamp_ns, node.removeprefix(f"{namespace}/"), what)
            for stamp_ns, topic, content in _contents(bag, texts.by_topic(bag))
            for node, what in texts.of_message(topic, content)
        ]
    times = _times(snapshots, np.array([stamp_ns for stamp_ns, _, _ in events], np.int64))
    return [Event(time_s, node, what) for time_s, (_, node, what) in zip(times, events, strict=True)]


class Pause(NamedTuple):
    """An interval in which no command reached the valve, on the time base of the bag's trajectory.

    Attributes:
        begin: time of the last snapshot before it [s].
        end: time of the last snapshot before the first command that reaches the valve again [s]; infinite if none does.
    """

    begin: float
    end: float


def time_closed(pauses: Iterable[Pause], begin: float, end: float) -> float:
    """Return the time of the pauses that begin and end within an interval: stops and trips during a run [s].

    Args:
        pauses: the pauses.
        begin: start of the interval [s].
        end: its end [s].
    """
    return sum(pause.end - pause.begin for pause in pauses if begin < pause.begin and pause.end < end)


def read_pauses(path: Path) -> list[Pause]:
    """Read the intervals in which the gate was closed and no command reached the valve.

    Args:
        path: folder of the bag, or one storage file.

    Returns:
        The pauses in their order; none in a bag without :data:`~ehls_ros.recording.topics.DRIVING`.

    Raises:
        BadInput: the bag cannot be read, or has no ``loader_state``.
    """
    with opened(path) as bag:
        snapshots = read_topics(bag, ())[LOADER_STATE.name]
        topic = DRIVING.resolve(namespace_of(bag))
        states = [(stamp_ns, bool(content.data)) for stamp_ns, _, content in _contents(bag, {topic: DRIVING.type})]
    times = _times(snapshots, np.array([stamp_ns for stamp_ns, _ in states], np.int64))
    found, since = list[Pause](), None
    for time, (_, driven) in zip(times, states, strict=True):
        if driven and since is not None:
            found.append(Pause(since, -math.inf if time is None else time))
            since = None
        elif not driven and since is None:
            since = -math.inf if time is None else time
    return found if since is None else [*found, Pause(since, math.inf)]


def _contents(bag: OpenBag, types: Mapping[str, str]) -> Iterator[tuple[int, str, Any]]:
    """Yield time of sending [ns], topic and content of each message on the topics of these types."""
    connections = [connection for connection in bag.reader.connections if types.get(connection.topic) == connection.msgtype]
    for connection, stamp_ns, message in bag.messages(connections):
        if len(message) > limits.MESSAGE:
            where = f"{bag.where}, {connection.topic}"
            raise BadInput(
                f"a message has {len(message)} bytes", where, f"at most {limits.MESSAGE} for type {connection.msgtype}"
            )
        with damage_reported(f"{bag.where}, {connection.topic}"):
            content = typestore().deserialize_cdr(message, connection.msgtype)
        yield stamp_ns, connection.topic, content


def _times(snapshots: MessageColumns, stamps_ns: NDArray[np.int64]) -> list[float | None]:
    """Return the sending times of messages on the run's time base."""
    order = np.argsort(snapshots[SENT], kind="stable")
    taken_ns = (snapshots[SECONDS].astype(np.int64) * 10**9 + snapshots[NANOSECONDS])[order]
    times = (taken_ns - (taken_ns.min() if taken_ns.min() >= UNIX_TIME_NS else 0)) / 1e9
    places = np.searchsorted(snapshots[SENT][order], stamps_ns, side="right") - 1
    return [float(times[place]) if place >= 0 else None for place in places.tolist()]


class _EventTexts:
    """Conversion of messages to event texts, with a memory of earlier values."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._values: dict[tuple[str, str], Any] = {}
        self._messages: dict[str, tuple[bytes, str]] = {}
        self._by_type: Mapping[str, Callable[[str, Any], Iterator[tuple[str, str]]]] = {
            PARAMETER_EVENTS.type: self._parameters,
            DIAGNOSTICS.type: self._diagnostics,
            transition_topic("").type: self._transition,
        }
        self._types: dict[str, str] = {}

    def by_topic(self, bag: OpenBag) -> Mapping[str, str]:
        """Return the types of the bag's topics that can be converted."""
        known = {name: known_topic(name, self._namespace) for name in bag.by_topic()}
        self._types = {name: topic.type for name, topic in known.items() if topic and topic.type in self._by_type}
        return self._types

    def of_message(self, topic: str, content: Any) -> Iterator[tuple[str, str]]:
        """Yield node and text for each event in a message."""
        yield from self._by_type[self._types[topic]](topic, content)

    def _parameters(self, _: str, event: Any) -> Iterator[tuple[str, str]]:
        for parameter in event.new_parameters:
            self._values[event.node, parameter.name] = _value(parameter.value)
        for parameter in event.changed_parameters:
            key, new = (event.node, parameter.name), _value(parameter.value)
            if key not in self._values or self._values[key] != new:
                yield event.node, f"{parameter.name}: {self._values.get(key, 'not known')} → {new}"
            self._values[key] = new

    def _transition(self, topic: str, event: Any) -> Iterator[tuple[str, str]]:
        if event.goal_state.id in PRIMARY_STATES:
            yield topic.removesuffix(f"/{TRANSITION_EVENT}"), f"{event.start_state.label} → {event.goal_state.label}"

    def _diagnostics(self, _: str, array: Any) -> Iterator[tuple[str, str]]:
        for status in array.status:
            level, message = bytes([status.level]), status.message
            # Figures in a message vary from one report to the next.
            reported = level, re.sub(r"[\d.]+", "", message)
            of_gate = any(value.key == OF_GATE for value in status.values)
            if reported != self._messages.get(status.name) and (of_gate or level != b"\0"):
                yield status.name, message
            self._messages[status.name] = reported


def _value(value: Any) -> Any:
    found = getattr(value, VALUES[value.type]) if value.type in VALUES else "not set"
    return found.tolist() if isinstance(found, np.ndarray) else found
