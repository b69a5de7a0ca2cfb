"""The log of a run, with all requests, actions and messages."""

import itertools
import math
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.hardware.gate_parameters import Parameters as Gate
from ehls_ros.physics.rig import Rig

LOOKBACK = 1.0
"""Time for which the more permissive value of a parameter still counts after a change: longer than any time of the gate [s]."""

IN_FLIGHT = 2
"""Commands from before the closing of the valve that may arrive after it: one on the wire, one that the bridge is sending."""

ROUNDING = 1e-9
"""Rounding tolerance of a time or a robustness, in any unit."""

TOGETHER = 5e-3
"""Longest time between two messages that a plant publishes one after the other [s]."""

UNDER_WAY = 0.5
"""Longest time that a message takes on a busy machine [s]."""

ENDS = frozenset({"killed", "ended"})
"""Happenings after which a process is gone."""


class Call(NamedTuple):
    """A request to a service.

    Attributes:
        service: its name below the namespace.
        fields: of the request.
        sent: time of the request, of the first one where it was repeated [s].
        answered: time of the answer; infinite if it was not awaited [s].
        success: whether it was carried out; None if unknown.
        message: of the answer.
    """

    service: str
    fields: Mapping[str, Any]
    sent: float
    answered: float = math.inf
    success: bool | None = None
    message: str = ""


class Happening(NamedTuple):
    """An action on a process, or an injected fault of the rig.

    Attributes:
        what: ``started``; ``stopped``, asked to end or broken on purpose; ``ended`` or ``killed``, when it was certainly gone;
            ``gone``, found to have ended by itself; ``frozen``, ``woken``; ``deaf``, its services hang; ``fault``, of the rig;
            ``state``, a query of a node's lifecycle state.
        whom: name of the process, line of the fault, or node and state.
        time: when it was certainly done [s].
        code: process number of one that was started or is gone; exit code of one that ended.
    """

    what: str
    whom: str
    time: float
    code: int = 0


class Journal:
    """Actions of a test on a graph, in order."""

    def __init__(self) -> None:
        """Start empty."""
        self.calls: list[Call] = []
        self.happenings: list[Happening] = []

    def note(self, what: str, whom: str, when: float | None = None, code: int = 0) -> float:
        """Note a happening, and return its time [s]; None: now."""
        moment = time.monotonic() if when is None else when
        self.happenings.append(Happening(what, whom, moment, code))
        return moment


class Report(NamedTuple):
    """A node's diagnostics, with the time of publication [s]."""

    time: float
    node: str
    level: int
    message: str
    values: Mapping[str, str]


class Setup(NamedTuple):
    """Configuration of a run.

    Attributes:
        period: control period [s].
        rig: the rig file, for its limits.
        gate: parameters of the gate.
        watchdog: time for which the target holds a command [s].
        plant: name of the node with the gate.
        hosts: names of the processes that run it.
        second_plants: names of processes that run another plant node for a while.
        lockstep: whether the rig waits for each answer: its time is then that of its cycles.
        resolution: of the valve's converter [m].
        gentle: whether no controller exceeds the rig's limits with its commands.
    """

    period: float
    rig: Rig
    gate: Gate
    watchdog: float = math.inf
    plant: str = "hardware_bridge_node"
    hosts: frozenset[str] = frozenset({"hardware_bridge_node"})
    second_plants: frozenset[str] = frozenset({"bridge again", "plant again"})
    lockstep: bool = False
    resolution: float = 2e-7
    gentle: bool = True


class Spans(NamedTuple):
    """Disjoint periods of time, in order.

    Attributes:
        begins: their beginnings [s], shape (n,).
        ends: their ends [s], shape (n,).
    """

    begins: Array
    ends: Array

    @classmethod
    def of(cls, spans: Iterable[tuple[float, float]]) -> "Spans":
        """Join overlapping spans, and sort them."""
        joined: list[list[float]] = []
        for begin, end in sorted(spans):
            if joined and begin <= joined[-1][1]:
                joined[-1][1] = max(joined[-1][1], end)
            elif end > begin:
                joined.append([begin, end])
        table = np.array(joined, dtype=float).reshape(-1, 2)
        return cls(table[:, 0], table[:, 1])

    def index(self, times: Array) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Return the index of the span that contains each time; -1 outside."""
        number = np.searchsorted(self.begins, times, side="right") - 1
        inside = (number >= 0) & (times < self.ends[np.maximum(number, 0)]) if self.begins.size else np.zeros(len(times), bool)
        return np.where(inside, number, -1)


@dataclass(frozen=True)
class Trace:
    """A run: the rig's log, requests, actions, and the messages on the graph; times are of ``time.monotonic`` [s].

    Attributes:
        setup: its configuration.
        log: the truth log by column; empty without an emulated rig.
        calls: requests to services, in the order of their answers.
        happenings: actions on processes and rig.
        messages: messages received, by topic: time of publication [s], header stamp [ns] and fields.
        reports: the diagnostics.
        load_cycles: number, first and last control cycle of each load cycle in a programme's log.
    """

    setup: Setup
    log: Mapping[str, Array] = field(default_factory=dict)
    calls: tuple[Call, ...] = ()
    happenings: tuple[Happening, ...] = ()
    messages: Mapping[str, list[tuple[Any, ...]]] = field(default_factory=dict)
    reports: tuple[Report, ...] = ()
    load_cycles: tuple[tuple[int, int, int], ...] = ()

    # The rig's rows

    @cached_property
    def moments(self) -> Array:
        """Time of each row by this computer's clock [s]."""
        return self.log.get("monotonic_s", np.empty(0))

    @cached_property
    def time(self) -> Array:
        """Time of each row [s]: of the cycles in lockstep, where the rig waits, else by this computer's clock."""
        return self.log["time_s"] if self.setup.lockstep and self.log else self.moments

    @cached_property
    def command(self) -> Array:
        """Command that acts on the valve in each row [m]."""
        return self.log.get("valve_command_m", np.empty(0))

    @cached_property
    def arrived(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether the rig accepted a command before each row; if not, it held the last one."""
        return np.diff(self.sequence, prepend=self.sequence[:1]) != 0.0

    @cached_property
    def sequence(self) -> Array:
        """Number of the last command accepted."""
        return self.log.get("output_sequence", np.empty(0))

    @cached_property
    def open(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether the valve is open in each row."""
        return self.command != 0.0

    @cached_property
    def lateness(self) -> float:
        """Longest delay of the rig itself [s]; it reveals a machine that is too busy."""
        return float(np.max(np.diff(self.moments), initial=0.0)) - self.setup.period if self.moments.size > 1 else 0.0

    @cached_property
    def transport_delay(self) -> Array:
        """Longest time that a packet which arrives before each row was kept on the wire on purpose [s]."""
        lines = self.happenings_of("fault")
        found = np.zeros(len(self.moments))
        for number, line in enumerate(lines):
            until = lines[number + 1].time if number + 1 < len(lines) else math.inf
            match line.whom.split():
                case ["delay", value]:
                    kept = (self.moments >= line.time - self.setup.period) & (self.moments <= until + float(value))
                    found[kept] = np.maximum(found[kept], float(value))
        return found

    @cached_property
    def commands_heard(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether, in each row, a command of every sender had been heard since its start: discovery may take a while."""
        times: dict[str, list[float]] = {}
        for sent, *_, sender in self.heard("valve_command"):
            times.setdefault(sender, []).append(sent)
        found = np.full(len(self.moments), bool(times))
        for sender, sent in times.items():
            starts = [h.time for h in self.happenings_of("started", {sender})]
            for since, until in itertools.pairwise([*starts, math.inf]):
                first = min((moment for moment in sent if since <= moment < until), default=until)
                found &= (self.moments < since) | (self.moments >= first)
        return found

    def at(self, moments: Array) -> Array:
        """Convert times of this computer's clock to those of the rows."""
        if not self.setup.lockstep or not self.moments.size:
            return moments
        beyond = len(self.time) * self.setup.period + self.time[0]
        return np.append(self.time, beyond)[np.searchsorted(self.moments, moments)]

    def since(self, marks: Array, moments: Array | None = None) -> Array:
        """Return the time from the last of some instants to each row, or to the given times; infinite before the first [s]."""
        moments = self.time if moments is None else moments
        last = np.searchsorted(marks, moments, side="right") - 1
        known = np.concatenate([[-math.inf], marks])
        return moments - known[last + 1]

    # Parameters of the gate

    def parameter(self, name: str, *, least: bool = False) -> Array:
        """Return the largest value that a parameter of the gate had within :data:`LOOKBACK` before each row, or the least."""
        sign = -1.0 if least else 1.0
        found = np.full(len(self.moments), -math.inf)
        for value, since, until in self._settings(name):
            held = (self.moments >= since) & (self.moments <= until + LOOKBACK)
            found[held] = np.maximum(found[held], sign * float(value))
        return sign * found

    def was(self, name: str, value: str) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Return whether a parameter of the gate had a text value within :data:`LOOKBACK` before each row."""
        found = np.zeros(len(self.moments), dtype=bool)
        for chosen, since, until in self._settings(name):
            if chosen == value:
                found |= (self.moments >= since) & (self.moments <= until + LOOKBACK)
        return found

    def _settings(self, name: str) -> Iterator[tuple[Any, float, float]]:
        """Yield each value of a parameter with its possible validity period; a new process starts with the initial values."""
        value, since = getattr(self.setup.gate, name), -math.inf
        for change in self._changes_of(name):
            yield value, since, change[2]
            value, since = change[0], change[1]
        yield value, since, math.inf

    def _changes_of(self, name: str) -> list[tuple[Any, float, float]]:
        """Return value, first and last time of each change of a parameter."""
        changes = [(call.fields["value"], call.sent, call.answered) for call in self.changes if call.fields["name"] == name]
        started = [(getattr(self.setup.gate, name), h.time, h.time) for h in self.happenings_of("started", self.setup.hosts)]
        return sorted([*changes, *started], key=lambda change: change[1])

    # Requests

    @cached_property
    def changes(self) -> list[Call]:
        """Requests that have changed a parameter of the plant, or may have."""
        service = f"{self.setup.plant}/set_parameters"
        return [call for call in self.calls if call.service == service and "name" in call.fields and call.success is not False]

    def called(self, service: str, *, success: bool = True, **fields: Any) -> list[Call]:
        """Return the answered requests to a service with the given fields."""
        return [
            call
            for call in self.calls
            if call.service == service
            and call.success is success
            and all(call.fields.get(name) == value for name, value in fields.items())
        ]

    @cached_property
    def openings(self) -> list[tuple[float, float]]:
        """Requests that may have opened the gate, each with its time and that of its answer [s].

        One is left out if it was refused by the only plant, or if an unacknowledged stop was engaged.
        """
        found = []
        for call in self.calls:
            if call.service != "enable" or not call.fields.get("data"):
                continue
            if call.success is False and not self._answered_by_another(call):
                continue
            answered = self._certainly_done(call)
            if not self._is_stopped(call.sent, answered):
                found.append((call.sent, answered))
        return sorted(found)

    def _certainly_done(self, call: Call) -> float:
        """Return the time by which a request was carried out [s]: that of the next answer to a request sent after it."""
        later = [c.answered for c in self.calls if c.service == call.service and c.sent >= call.sent and c.success is not None]
        return min([call.answered, *later])

    def _answered_by_another(self, call: Call) -> bool:
        """Return whether another node answers the same services: its refusal gives no information on the plant."""
        others = [h for h in self.happenings if h.what == "started" and h.whom.endswith("again")]
        return any(h.time <= call.answered for h in others)

    def _is_stopped(self, sent: float, answered: float) -> bool:
        """Return whether a stop was engaged throughout a time, without an acknowledgement in or before it."""
        began = max((h.time for h in self.happenings_of("started", self.setup.hosts) if h.time <= sent), default=-math.inf)
        stops = [call for call in self.called("emergency_stop") if began < call.answered <= sent]
        if not stops:
            return False
        newest = stops[-1]
        return not any(
            call.service == "acknowledge_stop" and call.success is not False and newest.sent <= call.sent <= answered
            for call in self.calls
            if call.success or call.fields.get("stop") == name_of_stop(newest)
        )

    def until_opened(self, begins: Iterable[float]) -> Spans:
        """Return the periods from each of some times to the next request that may have opened the gate.

        A request under way at the beginning ends the period at once: it may have been carried out after it.
        """
        spans = []
        for begin in begins:
            following = [max(begin, sent) for sent, answered in self.openings if answered > begin]
            spans.append((begin, min(following, default=math.inf)))
        return Spans.of(spans)

    def happenings_of(self, what: str, whom: Iterable[str] | None = None) -> list[Happening]:
        """Return the happenings of a kind, to any process or to some."""
        names = None if whom is None else set(whom)
        return [h for h in self.happenings if h.what == what and (names is None or h.whom in names)]

    def frozen(self, whom: Iterable[str]) -> list[tuple[float, float]]:
        """Return the periods in which processes were frozen."""
        names, found = set(whom), []
        for number, happening in enumerate(self.happenings):
            if happening.what == "frozen" and happening.whom in names:
                later = (h for h in self.happenings[number:] if h.whom == happening.whom and h.what in {"woken", *ENDS})
                if (woken := next(later, None)) is not None:
                    found.append((happening.time, woken.time))
        return found

    # Messages

    def heard(self, topic: str) -> list[tuple[Any, ...]]:
        """Return the messages of a topic in the order of publication: time [s], stamp [ns], fields."""
        return sorted(self.messages.get(topic, []), key=lambda message: message[0])

    @cached_property
    def driving(self) -> list[tuple[float, bool]]:
        """Announcements that commands reach the valve, or no longer do, in order: time [s], whether they do.

        The message does not name its sender. A second plant, whose gate is closed, announces that they do not; only from the
        plant itself does such an announcement come together with one of its driver.
        """
        begun = self.happenings_of("started", self.setup.second_plants)
        lives = [
            (start.time, next((h.time for h in self.happenings_of("ended", {start.whom}) if h.time > start.time), math.inf))
            for start in begun
        ]
        processes = {str(start.code) for start in begun}
        closed = [m[0] for m in self.heard("driver") if not m[3] and m[5].rpartition("-")[2] not in processes]
        return [
            (when, bool(driving))
            for when, driving, *_ in self.heard("driving")
            if driving
            or not any(begin < when < end + UNDER_WAY for begin, end in lives)
            or any(abs(moment - when) < TOGETHER for moment in closed)
        ]

    def with_load_cycles(self, load_cycles: Iterable[tuple[int, int, int]]) -> "Trace":
        """Return the trace with a programme's log of load cycles added."""
        return replace(self, load_cycles=tuple(load_cycles))

    @cached_property
    def runs(self) -> list[float]:
        """Times at which the plant's cycles restarted [s]."""
        states = self.of_plant()
        return [state[0] for before, state in itertools.pairwise(states) if state[2] < before[2]]

    def run_of(self, moment: float) -> int:
        """Return the number of the plant's run at a time [s], from 0."""
        return bisect_right(self.runs, moment)

    def of_plant(self) -> list[tuple[Any, ...]]:
        """Return the snapshots of the plant whose gate is obeyed, and of no other sender."""
        plants = {message[5] for message in self.heard("driver")}
        return [message for message in self.heard("loader_state") if message[-1] in plants]


def name_of_stop(call: Call) -> str:
    """Return the name of the stop that a request engaged."""
    return call.message.partition(";")[0]
