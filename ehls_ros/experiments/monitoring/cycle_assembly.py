"""Assembly of the messages of a running graph, by control cycle, to samples on a strictly increasing time axis.

The samples equal those of a recording of the same graph (:mod:`ehls_ros.recording.alignment`). Time is counted in control
cycles, so that steps and drift of the wall clock have no effect on it. The stamps give the wall time of an instant.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.recording.topics import DISTURBANCE, LOADER_STATE, VALVE_COMMAND

STATE_SIGNALS = tuple(LOADER_STATE.signals.values())
COMMAND_SIGNAL = VALVE_COMMAND.signals["spool"]
DISTURBANCE_SIGNALS = tuple(DISTURBANCE.signals.values())

MAX_WAIT = 0.2
"""Maximum wait of a snapshot for its command and disturbance; later they count as missing [s]."""

LOCKSTEP_MAX_WAIT = 10.0
"""The same in lockstep [s]: each snapshot has both, and only the middleware may delay them."""

MAX_LATE_CYCLES = 200
"""Age of a cycle above which its missing message counts as lost, since each sender's messages arrive in order [cycles]."""

SETTLING = 1.0
"""Time left out after the opening of the gate, for the blending of commands [s]."""

MIN_PAUSE = 1.0
"""Minimum time between two runs of the rig on the axis, sufficient to start a new stretch [s]."""

MAX_PAUSE = 400.0 * 86400.0
"""Longest plausible time between two stamps [s]; beyond it, the clock was set."""

MAX_CLOCK_ERROR = 0.05
"""Deviation of a stamp from its prediction above which the clock was set, or a cycle was delayed [s]."""

MAX_ANCHORS = 1000
"""Maximum number of anchors; the oldest ones are no longer needed for any change."""


class Anchor(NamedTuple):
    """An instant on both axes.

    Attributes:
        time: time on the axis of samples [s].
        stamp_ns: header stamp [ns].
    """

    time: float
    stamp_ns: int


class LoaderSnapshot(NamedTuple):
    """A loader_state message.

    Attributes:
        stamp_ns: header stamp [ns].
        cycle: control cycle.
        values: values in the order of the fields.
        sent_ns: time of publication by the system clock [ns].
    """

    stamp_ns: int
    cycle: int
    values: tuple[float, ...]
    sent_ns: int


class Stretch(NamedTuple):
    """Consecutive samples, all driven by the recorded command.

    Attributes:
        time_s: times, shape (n,) [s].
        signals: values by the names of the data contract, shape (n,).
        interrupted: whether there is a gap before these samples.
    """

    time_s: Array
    signals: dict[str, Array]
    interrupted: bool


class CycleAssembler:
    """Assembler of the messages of a graph to samples.

    Attributes:
        anchors: wall times along the axis, oldest first.
        lost: number of cycles without a snapshot.
        unanswered: number of cycles without a command.
        runs: number of restarts of the cycle count.
    """

    def __init__(self, period: float, anchors: Sequence[Anchor] = (), end: float = 0.0, max_wait: float = MAX_WAIT) -> None:
        """Begin without messages.

        Args:
            period: time between two control cycles [s].
            anchors: anchors of an earlier assembler, whose axis is continued.
            end: end of that axis [s].
            max_wait: time for which a snapshot waits for the other messages of its cycle, by the system clock [s].
        """
        self._period = period
        self._max_wait_ns = round(max_wait * 1e9)
        self.anchors = list(anchors)
        self.lost = self.unanswered = self.runs = 0
        self._offset = math.nan
        self._end = end
        self._pending = list[LoaderSnapshot]()
        self._newest = -1
        self._commands: dict[int, tuple[float, int]] = {}
        self._disturbances: dict[int, tuple[float, ...]] = {}
        self._disturbed = False
        self._controllers = list[tuple[int, str]]()
        self._gate_states = list[tuple[int, bool]]()
        self._closed_until = -math.inf
        self._interrupted = True

    # --- messages -----------------------------------------------------------------------------------

    def add_controller(self, cycle: int, sender: str) -> None:
        """Register the active controller from a cycle on; an empty name: any."""
        self._controllers = [known for known in self._controllers if known[0] < cycle][-10:]
        self._controllers.append((cycle, sender))

    def add_driving(self, driving: bool, sent_ns: int) -> None:
        """Register whether commands reach the valve from a time of the system clock on [ns]."""
        self._gate_states = [*self._gate_states[-10:], (sent_ns, driving)]

    def add_commands(self, messages: Iterable[tuple[int, float, str, int]]) -> None:
        """Add valve commands: cycle, spool [m], sender and time of sending [ns]; the first for a cycle is used."""
        for cycle, spool, sender, sent_ns in messages:
            if not self._controllers or self._controller(cycle) in {"", sender}:
                self._commands.setdefault(cycle, (spool, sent_ns))

    def add_disturbances(self, messages: Iterable[tuple[int, tuple[float, ...]]]) -> None:
        """Add disturbances: cycle and values in the order of the fields."""
        for cycle, values in messages:
            self._disturbances[cycle] = values
            self._disturbed = True

    def _controller(self, cycle: int) -> str:
        known = bisect_right(self._controllers, cycle, key=lambda entry: entry[0])
        return self._controllers[known - 1][1] if known else ""

    # --- samples --------------------------------------------------------------------------------------

    def add_snapshots(self, snapshots: Iterable[LoaderSnapshot]) -> list[Stretch]:
        """Add snapshots, and return the completed samples.

        Args:
            snapshots: snapshots in the order of sending.
        """
        out = list[Stretch]()
        for snapshot in snapshots:
            if snapshot.cycle == self._newest:
                continue
            if snapshot.cycle < self._newest:
                self._end_run(snapshot, out)
            elif self._newest >= 0:
                self.lost += snapshot.cycle - self._newest - 1
            self._newest = snapshot.cycle
            self._pending.append(snapshot)
        ready = self._ready()
        last = self._pending[ready - 1] if ready else None
        self._emit(ready, out)
        if last is not None:
            self._discard_late(last)
        return out

    def _end_run(self, first: LoaderSnapshot, out: list[Stretch]) -> None:
        """End a run of the rig when a snapshot starts a new one."""
        self._emit(len(self._pending), out)
        self.runs += 1
        self._offset = math.nan
        self._commands = {cycle: known for cycle, known in self._commands.items() if known[1] >= first.sent_ns}
        self._controllers = self._controllers[-1:]
        self._pending.clear()

    def _ready(self) -> int:
        """Return the number of pending snapshots that are complete, or whose waiting time is over.

        The newest always waits, as only the next one shows whether its command reached the valve.
        """
        if not self._pending:
            return 0
        oldest_ns = self._pending[-1].sent_ns - self._max_wait_ns
        newest = max(self._commands, default=-1)
        if self._disturbed:
            newest = min(newest, max(self._disturbances, default=-1))
        for index, snapshot in enumerate(self._pending[:-1]):
            known = snapshot.cycle in self._commands and (not self._disturbed or snapshot.cycle in self._disturbances)
            if not known and snapshot.sent_ns > oldest_ns and snapshot.cycle > newest - MAX_LATE_CYCLES:
                return index
        return len(self._pending) - 1

    def _emit(self, count: int, out: list[Stretch]) -> None:
        if not count:
            return
        rows, following = self._pending[:count], self._pending[1 : count + 1]
        self._pending = self._pending[count:]
        if math.isnan(self._offset):
            self._begin_run(rows[0])
        time = np.array([row.cycle for row in rows]) * self._period + self._offset
        self._anchor(rows, time)
        self._end = float(time[-1])
        driven = self._driven(rows, following, time)
        commands = [self._commands.pop(row.cycle, (math.nan, 0))[0] for row in rows]
        self.unanswered += sum(map(math.isnan, commands))
        none = (math.nan,) * len(DISTURBANCE_SIGNALS)
        acting = [self._disturbances.pop(row.cycle, none) for row in rows]
        table = np.column_stack([np.array([row.values for row in rows]), commands, acting])
        names = [*STATE_SIGNALS, COMMAND_SIGNAL, *(DISTURBANCE_SIGNALS if self._disturbed else ())]
        edges = np.flatnonzero(np.diff(driven.astype(np.int8))) + 1
        for part in np.split(np.arange(count), edges):
            if driven[part[0]]:
                signals = {name: table[part, column] for column, name in enumerate(names)}
                out.append(Stretch(time[part], signals, self._interrupted))
                self._interrupted = False
            else:
                self._interrupted = True

    def _driven(self, rows: Sequence[LoaderSnapshot], following: Sequence[LoaderSnapshot], time: Array) -> NDArray[np.bool_]:
        """Return which samples are driven by the recorded command, shape (n,)."""
        if not self._gate_states:
            return np.ones(len(rows), dtype=np.bool_)
        after = [*(row.sent_ns for row in following), rows[-1].sent_ns][: len(rows)]
        drives = self._drives([row.sent_ns for row in rows]) & self._drives(after)
        closed_until = np.maximum.accumulate(np.where(drives, self._closed_until, time))
        self._closed_until = float(closed_until[-1])
        out: NDArray[np.bool_] = drives & (time >= closed_until + SETTLING)
        return out

    def _drives(self, sent_ns: Sequence[int]) -> NDArray[np.bool_]:
        """Return whether commands reached the valve at times of the system clock [ns]."""
        since = np.array([since_ns for since_ns, _ in self._gate_states], dtype=np.int64)
        # The state before the first message is unknown and taken from it; the plant publishes on change.
        known = np.maximum(np.searchsorted(since, np.array(sent_ns, dtype=np.int64), side="right") - 1, 0)
        return np.array([driving for _, driving in self._gate_states], dtype=np.bool_)[known]

    def _begin_run(self, first: LoaderSnapshot) -> None:
        """Place the first cycle of a run after the previous run, by the time between the stamps, within limits."""
        begin = self._end
        if self.anchors:
            since = (first.stamp_ns - self.stamp_ns(self._end)) * 1e-9
            begin += min(max(since, MIN_PAUSE), MAX_PAUSE)
        self._offset = begin - first.cycle * self._period
        self._interrupted = True

    def _anchor(self, rows: Sequence[LoaderSnapshot], time: Array) -> None:
        """Add anchors at stamps that deviate from their prediction."""
        stamps_ns = np.array([row.stamp_ns for row in rows], dtype=np.int64)
        first = 0
        while first < len(rows):
            if not self.anchors or abs(int(stamps_ns[first]) - self.stamp_ns(float(time[first]))) > MAX_CLOCK_ERROR * 1e9:
                self.anchors = [*self.anchors[1 - MAX_ANCHORS :], Anchor(float(time[first]), int(stamps_ns[first]))]
            anchor = self.anchors[-1]
            apart = (stamps_ns[first:] - anchor.stamp_ns) * 1e-9 - (time[first:] - anchor.time)
            first += int(np.argmax(np.abs(apart) > MAX_CLOCK_ERROR)) if np.any(np.abs(apart) > MAX_CLOCK_ERROR) else len(rows)

    def _discard_late(self, last: LoaderSnapshot) -> None:
        """Discard messages too late for their cycle; much later ones belong to another run."""
        late = last.sent_ns + round(MIN_PAUSE * 1e9)
        self._commands = {cycle: c for cycle, c in self._commands.items() if cycle > last.cycle or c[1] > late}
        self._disturbances = {cycle: d for cycle, d in self._disturbances.items() if cycle > last.cycle}

    @property
    def driving(self) -> bool:
        """Whether commands reach the valve now; True if nothing is known."""
        return not self._gate_states or self._gate_states[-1][1]

    # --- wall time ------------------------------------------------------------------------------------

    @property
    def end(self) -> float:
        """Newest time on the axis [s]."""
        return self._end

    def stamp_ns(self, time: float) -> int:
        """Return the stamp of an instant on the axis [ns]; 0 if unknown.

        Args:
            time: the instant [s].
        """
        if not self.anchors or not math.isfinite(time):
            return 0
        known = max(bisect_right(self.anchors, time, key=lambda anchor: anchor.time), 1)
        anchor = self.anchors[known - 1]
        return max(0, anchor.stamp_ns + round((time - anchor.time) * 1e9))
