"""Order and clocks of a topic's messages: their times compared with those at which the recorder received them.

The stamp in a header is set by the sender's clock. That clock may be set while the rig runs, count from the boot or be the
clock of another computer; stamps may be unset. The recorder received all messages by one clock, and in the order of sending
except for a few.
"""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.errors import BadInput

Times = NDArray[np.float64]

UNIX_TIME = 1e9
"""Time from which a clock counts from 1970 [s]."""

NEVER = 60.0
"""Change of the delay from one message to the next that no transport causes [s]."""

HOLE = 20.0
"""Interval from late messages to the following one, above which they do not belong there [periods]."""

MANY_LATE = 0.1
"""Fraction of messages out of order above which they have several senders or clocks, if they are late by several periods."""

PERIODS = 3.0
"""Lateness that reordering does not cause in many messages [periods]."""

AHEAD = 5.0
"""Step of the stamps at which messages were lost or the clock was set [periods]."""

AROUND = 20
"""Number of messages before and after a step whose delays are compared."""

APART, NOTED = 1.0, 0.05
"""Differences of the topics' delays above which their clocks differ, and above which they may [s]."""


MEND = "mend: true beside the name there shifts the later ones"
"""Advice for a clock that was set back."""


class Arrived(NamedTuple):
    """Messages of a topic in the order of their times.

    Attributes:
        order: indices of the messages; one that repeats a time is left out.
        remarks: one sentence each.
    """

    order: NDArray[np.intp]
    remarks: tuple[str, ...]


class Clock(NamedTuple):
    """Clock of a topic's times.

    Attributes:
        source: the stamp, the time of reception, or the field that holds the time.
        time: one of its times [s]; not the first, which is the likeliest to be unset.
        delay: median time from it to the reception [s].
        given: the map names the source, so a different clock is intended.
    """

    source: str
    time: float
    delay: float
    given: bool

    @property
    def unix(self) -> bool:
        """Whether it counts from 1970."""
        return self.time >= UNIX_TIME


class Arrivals(NamedTuple):
    """Messages of a topic in order of arrival.

    Attributes:
        time: their times, shape (n,) [s].
        received: times of their reception, shape (n,) [s].
        numbers: their numbers on the topic, from 1, shape (n,).
        zero: zero of ``time`` on its clock [s].
        source: source of the times, such as ``header.stamp``.
        where: bag and topic, for errors.
        remedy: entry of the map with another source.
    """

    time: Times
    received: Times
    numbers: NDArray[np.intp]
    zero: float
    source: str
    where: str
    remedy: str

    def arranged(self) -> Arrived:
        """Sort the messages by their times.

        Raises:
            BadInput: a time is not finite, the clock was set, or the messages have several clocks.
        """
        time, steps, waits = self.time, np.diff(self.time), np.diff(self.received)
        unknown = np.flatnonzero(~np.isfinite(time))
        if len(unknown):
            what = f"{self.source} of message {self.numbers[unknown[0]]} is {time[unknown[0]]}"
            raise BadInput(what, self.where, f"a finite time, or {self.remedy}")
        self._check_jumps(steps, waits)
        latest = np.maximum.accumulate(time)
        late, period = np.flatnonzero(time < latest), self._period(steps)
        self._check_back(late, latest, period)
        order = np.argsort(time, kind="stable")
        order = order[np.diff(time[order], prepend=-np.inf) > 0.0]
        remarks = list[str]()
        if len(late):
            most = _duration(float(np.max(latest[late] - time[late])))
            remarks.append(f"{len(late)} messages arrived after later ones, by up to {most}, and are sorted by {self.source}")
        if len(order) < len(time):
            remarks.append(f"{len(time) - len(order)} messages repeat a time and are left out")
        return Arrived(order, (*remarks, *self._steps_ahead(steps, waits, period)))

    def mended(self) -> tuple["Arrivals", list[str]]:
        """Return the messages as if their clock had not been set back, with a remark for each time it was."""
        arrivals, remarks = self, list[str]()
        steps, both = np.diff(self.time), set_back(self.received)
        usual, period = _median(steps[steps > 0.0]), self._period(steps)
        while len(remarks) < AROUND and (k := arrivals._set_back(period)) is not None:
            time, wait = arrivals.time, float(self.received[k] - self.received[k - 1])
            size = time[k - 1] + (usual if both else wait) - time[k]
            arrivals = arrivals._replace(time=np.concatenate([time[:k], time[k:] + size]))
            remarks.append(f"{self.source} was set back by {_duration(size)} at message {self.numbers[k]}; this is mended")
        return arrivals, remarks

    def _set_back(self, period: float) -> int | None:
        """Return the first message after the clock was set back. Messages that only arrived late fill a gap among others."""
        late = np.flatnonzero(self.time < np.maximum.accumulate(self.time))
        for run, overlapping, following in _late_runs(self.time, late):
            if overlapping or following > HOLE * period or len(run) > max(AROUND, MANY_LATE * len(self.time)):
                return int(run[0])
        return None

    def _period(self, steps: Times) -> float:
        """Return the usual interval between messages [s]; by the reception if many of them are out of order."""
        waits = np.diff(self.received)
        known = (_median(steps[steps > 0.0]), float(np.sum(waits[waits > 0.0])) / max(1, len(steps)))
        return min((period for period in known if period > 0.0), default=0.0)

    def _check_jumps(self, steps: Times, waits: Times) -> None:
        """Reject times that jump while the messages arrive without a gap: unset, or set by another clock."""
        jumps = np.flatnonzero((np.abs(steps - waits) > NEVER) & ((steps < 0.0) | (steps > NEVER)))
        if len(jumps):
            k = int(jumps[0])
            first, second = (f"{moment(self.zero + self.time[i])} in message {self.numbers[i]}" for i in (k, k + 1))
            more = f"; there are {len(jumps)} such jumps" if len(jumps) > 1 else ""
            what = f"{self.source} is {first} and {second}, received {_duration(waits[k])} apart{more}"
            raise BadInput(what, self.where, f"the times of one clock, or {self.remedy}")

    def _check_back(self, late: NDArray[np.intp], latest: Times, period: float) -> None:
        """Reject times that go back for good."""
        expected = f"messages of one sender whose clock is not set, or {self.remedy}"
        lateness, k = latest[late] - self.time[late], self._set_back(period)
        if k is not None:
            back, size = latest[k] - self.time[k], latest[k] - self.time[k] + period
            what = f"{self.source} goes back by {_duration(back)} from message {self.numbers[k - 1]} to {self.numbers[k]}"
            if set_back(self.received):
                found = f"{what}: its clock was set back by about {_duration(size)}, and that of the recorder as well"
                raise BadInput(found, self.where, f"a recording during which no clock is set; {MEND}")
            apart = _duration(self.received[k] - self.received[k - 1])
            found = f"{what}, received {apart} apart: its clock was set back by about {_duration(size)}"
            raise BadInput(found, self.where, f"{expected}; {MEND}")
        if len(late) > MANY_LATE * len(self.time) and float(np.median(lateness)) > PERIODS * period:
            what = f"{self.source} goes back {len(late)} times in {len(self.time)} messages"
            begin = f"first by {_duration(lateness[0])} in message {self.numbers[late[0]]}"
            raise BadInput(f"{what}, {begin}", self.where, expected)

    def _steps_ahead(self, steps: Times, waits: Times, period: float) -> list[str]:
        """Describe the largest step ahead of the times without a gap in the reception."""
        large = np.flatnonzero((steps > AHEAD * period) & (steps - waits > 0.5 * steps) & (period > 0.0))
        delay = self.received - self.time
        for k in large[np.argsort(-steps[large])][:AROUND].tolist():
            before, after = delay[max(0, k + 1 - AROUND) : k + 1], delay[k + 1 : k + 1 + AROUND]
            if _median(before) - _median(after) > 0.5 * steps[k]:
                size = f"{self.source} steps ahead by {_duration(steps[k] - waits[k])}"
                place = f"from message {self.numbers[k]} to {self.numbers[k + 1]}"
                return [f"{size} {place}, but not the reception: messages were lost, or the clock was set"]
        return []


def set_back(time: Times) -> bool:
    """Return whether times in order of writing go back among earlier ones, as those of a clock that was set back.

    Args:
        time: the times, shape (n,) [s].
    """
    late = np.flatnonzero(time < np.maximum.accumulate(time))
    return any(overlapping for _, overlapping, _ in _late_runs(time, late))


def _late_runs(time: Times, late: NDArray[np.intp]) -> Iterator[tuple[NDArray[np.intp], bool, float]]:
    """Yield each run of late messages, whether others lie between its times, and the interval to the next one [s]."""
    ordered = np.sort(time)
    for run in np.split(late, np.flatnonzero(np.diff(late) > 1) + 1) if len(late) else ():
        low, high = float(np.min(time[run])), float(np.max(time[run]))
        first, behind = np.searchsorted(ordered, low), np.searchsorted(ordered, high, side="right")
        between = int(behind - first) - len(run)
        following = float(ordered[behind]) - high if behind < len(ordered) else 0.0
        yield run, len(run) > 1 and between >= min(2.0, 0.5 * len(run)), following


def check_clocks(clocks: Mapping[str, Clock], where: str) -> list[str]:
    """Check that the times of several topics are of one clock.

    Args:
        clocks: by topic.
        where: the bag, for the error.

    Returns:
        Remarks on small differences.

    Raises:
        BadInput: the clocks differ.
    """
    remedy = "one clock: 'tables: {{{}}}' in the map, or an offset"
    if not clocks:
        return []
    others = {name: clock for name, clock in clocks.items() if not clock.unix}
    unix = {name: clock for name, clock in clocks.items() if clock.unix}
    if others and unix:
        found = "; ".join(
            f"{name}: {clock.source} counts from boot or start ({moment(clock.time)})" for name, clock in others.items()
        )
        rest = "; ".join(f"{name}: {clock.source} is Unix time ({moment(clock.time)})" for name, clock in unix.items())
        raise BadInput(f"its topics have different clocks: {found}; {rest}", where, remedy.format(_received(others)))
    ordered = sorted(clocks, key=lambda name: clocks[name].delay)
    first, last = (clocks[name] for name in (ordered[0], ordered[-1]))
    if (apart := last.delay - first.delay) <= NOTED:
        return []
    found = " and ".join(
        f"{clocks[name].source} of {name} is {_late(clocks[name].delay)}" for name in (ordered[0], ordered[-1])
    )
    if apart > APART and not (first.given and last.given):
        wrong = max((first, last), key=lambda clock: abs(clock.delay))
        named = {name: clock for name, clock in clocks.items() if abs(clock.delay) > 0.5 * abs(wrong.delay)}
        raise BadInput(f"the clocks of its topics differ: {found}", where, remedy.format(_received(named)))
    return [f"the clocks of the topics may differ: {found}"]


def _received(clocks: Mapping[str, Clock]) -> str:
    return ", ".join(f"{name}: {{name: received}}" for name in clocks)


def _late(delay: float) -> str:
    return f"{_duration(abs(delay))} {'before' if delay >= 0.0 else 'after'} its reception"


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.4g} ms" if abs(seconds) < 1.0 else f"{seconds:.6g} s"


def moment(seconds: float) -> str:
    """Return a time in words: a date of Unix time, else seconds.

    Args:
        seconds: the time [s].
    """
    if UNIX_TIME <= seconds < 1e11:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]
    return f"{seconds:.9g} s"


def _median(values: Times) -> float:
    return float(np.median(values)) if len(values) else 0.0
