"""Run a programme: start, stop, hold, skip, resume and pace it as a function of the control cycle alone.

A stop does not leave the programme's path. Its time slows down to a standstill within ``stop_time``, so that no force occurs
that the programme does not contain; only then the value moves to the held one. Resuming returns to the path and accelerates its
time again. Pacing also changes the speed of that time and nothing else: to zero at each reversal (static), or to a fraction of
the normal speed (dynamic), with a continuous second derivative.

A :class:`Motion` applies from a control cycle on. It consists of plain numbers that can be stored; a node restarted with the
same motions yields bitwise the same values in the same cycles.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ehls_ros.arrays import Array
from ehls_ros.control.programme.expansion import CLOSE, SHORT, Points, Programme, programme_of

Row = tuple[float, float, float]
"""A value with its first and second derivative."""

EASING = 0.2
"""Time in which a programme's time slows down before a wait, and speeds up after it, as a fraction of the time between two
reversals: the third derivative remains in the order of that of the programme."""


STEEPEST = 1.5
"""Largest rate of the speed at the beginning of a leg times its duration, that of a leg from standstill to normal speed: a leg
that takes over from a shorter one is as short, or it would swing beyond the speeds between which it leads."""


class State(IntEnum):
    """State of a programme, as in ``programme_point``."""

    STARTING = 0
    RUNNING = 1
    STOPPING = 2
    STOPPED = 3
    RESUMING = 4
    FINISHED = 5
    WAITING = 6


class Leg(NamedTuple):
    """Part of a motion: the speed of the programme's time changes, or, with a row, the value moves to another at rest.

    Attributes:
        duration: duration [s].
        since: programme time at its beginning [s].
        speed: speed of the programme's time at its beginning, 1 for the normal speed [1].
        growth: rate of that speed [1/s].
        end_speed: final speed, reached with zero rate [1].
        row: value, first and second derivative at its beginning.
        to: final value.
    """

    duration: float
    since: float
    speed: float = 0.0
    growth: float = 0.0
    end_speed: float = 0.0
    row: Row | None = None
    to: float = 0.0


class Skip(NamedTuple):
    """Skipped load cycles: the programme time from which they are missing [s], and their number."""

    to: float
    load_cycles: int


class Motion(NamedTuple):
    """Motion from a control cycle on: some legs, then the programme at a constant speed or at rest.

    Attributes:
        first: first control cycle.
        kind: request that caused the motion; ``pace``: pacing.
        legs: parts before the final phase.
        since: programme time at the end of the legs [s].
        rests: value held from then on; None if the programme runs.
        skipped: load cycles skipped so far.
        reason: reason of a stop, or of the speed.
        speed: speed of the programme's time after the legs; if the programme is stopped, after it is resumed. 1: normal speed,
            0: it waits for the measured value.
    """

    first: int
    kind: Literal["start", "stop", "resume", "skip", "pace"]
    legs: tuple[Leg, ...]
    since: float
    rests: float | None = None
    skipped: tuple[Skip, ...] = ()
    reason: str = ""
    speed: float = 1.0


class Rows(NamedTuple):
    """Setpoints of a programme in some control cycles, one entry each.

    Attributes:
        reference: value, first and second derivative, shape (n, 3).
        points: positions in the programme.
        state: :class:`State` of each, shape (n,).
    """

    reference: Array
    points: Points
    state: NDArray[np.int64]


class Moving(NamedTuple):
    """Motion of a programme at some times.

    Attributes:
        since: programme time, shape (n,) [s].
        speed: speed of that time, 1 for the normal speed, shape (n,).
        growth: rate of the speed, shape (n,) [1/s].
        off: value with two derivatives where the programme is off its path, otherwise NaN, shape (n, 3).
        busy: whether a leg is in progress, shape (n,).
    """

    since: Array
    speed: Array
    growth: Array
    off: Array
    busy: NDArray[np.bool_]

    @classmethod
    def empty(cls, count: int) -> "Moving":
        """Return motions to be filled in: at rest and on the path."""
        rows = np.full((count, 3), np.nan)
        return cls(np.empty(count), np.zeros(count), np.zeros(count), rows, np.zeros(count, np.bool_))


class Runner:
    """Programme in execution.

    Attributes:
        programme: the programme.
        motions: motions in the order of their control cycles.
    """

    def __init__(self, programme: Programme, period: float, motions: tuple[Motion, ...]) -> None:
        """Set up a programme with its motions so far.

        Args:
            programme: the programme.
            period: control period [s].
            motions: at least one; see :meth:`beginning` and :meth:`resting`.
        """
        self.programme = programme
        self.motions = list(motions)
        self._period = period
        p = programme.parameters
        self._stop_time, self._hold_time, self._hold = p.stop_time, p.hold_time, p.hold

    @staticmethod
    def beginning(programme: Programme, first: int, measured: float | None = None, lead: float = 0.0) -> Motion:
        """Return the motion that starts a programme.

        Args:
            programme: the programme.
            first: control cycle in which it starts.
            measured: measured value from which it is led in; None to start at once.
            lead: duration of the lead-in [s].
        """
        speed = 0.0 if programme.leaf(0.0).pacing.mode == "static" else 1.0
        if measured is None or lead <= 0.0:
            return Motion(first, "start", (), 0.0, speed=speed)
        glide = Leg(lead, 0.0, row=(measured, 0.0, 0.0), to=programme.parameters.start)
        legs = (glide, Leg(programme.parameters.stop_time, 0.0, end_speed=speed)) if speed else (glide,)
        return Motion(first, "start", legs, _end(legs, 0.0), speed=speed)

    def resting(self, first: int, since: float, measured: float, reason: str, skipped: tuple[Skip, ...] = ()) -> Motion:
        """Return the motion to the held value, for a rig that has left the programme's path.

        Args:
            first: control cycle.
            since: programme time of the stop [s].
            measured: measured value of the rig.
            reason: reason of the stop.
            skipped: load cycles skipped so far.
        """
        since = _past_skips(since, skipped)
        held = self._held(since)
        glide = Leg(self._hold_time, since, row=(measured, 0.0, 0.0), to=held)
        return Motion(first, "stop", (glide,), since, held, skipped, reason, self.motions[-1].speed)

    def rows(self, first: int, count: int) -> Rows:
        """Return the programme's setpoints in consecutive control cycles.

        Args:
            first: first control cycle.
            count: number of control cycles.
        """
        cycles = np.arange(first, first + count)
        made = Rows(
            np.empty((count, 3)),
            Points.empty(count),
            np.zeros(count, np.int64),
        )
        firsts = [motion.first for motion in self.motions]
        holding = np.maximum(np.searchsorted(firsts, cycles, side="right") - 1, 0)
        for i in np.unique(holding):
            self._fill(made, np.flatnonzero(holding == i), cycles, self.motions[i])
        return made

    def at(self, cycle: int) -> tuple[float, State]:
        """Return programme time [s] and state in a control cycle."""
        motion = self._motion(cycle)
        moving = self._moving(motion, np.array([cycle]))
        return float(moving.since[0]), State(int(self._states(motion, moving, np.array([cycle]))[0]))

    def stop(self, cycle: int, reason: str) -> bool:
        """Stop from a control cycle on; return whether there was anything to stop."""
        motion, (since, speed, growth), row = self._now(cycle)
        if motion.kind == "stop" or motion.rests is not None or since >= self.programme.duration - CLOSE:
            return False
        legs, since, row = self._slowed(since, speed, growth, row)
        since = _past_skips(since, motion.skipped)
        held = self._held(since)
        legs += self._way(row, since, held)
        self._add(Motion(cycle, "stop", tuple(legs), since, held, motion.skipped, reason, motion.speed))
        return True

    def resume(self, cycle: int) -> bool:
        """Resume from a control cycle on; return whether the programme was stopped."""
        motion, (since, speed, growth), row = self._now(cycle)
        if motion.rests is None or since >= self.programme.duration - CLOSE:
            return False
        legs: list[Leg] = []
        goes_on = _past_skips(since, motion.skipped)
        if goes_on > since or not motion.speed:
            # A stop while a block was being skipped: the remainder of that block is not resumed. And what waits comes to rest.
            legs, since, row = self._slowed(since, speed, growth, row)
            since, speed, growth = max(goes_on, since), 0.0, 0.0
        if not speed:
            legs += self._way(row, since, self.programme.value(since))
        if motion.speed:
            legs.append(self._change(since, speed, growth, motion.speed))
        self._add(Motion(cycle, "resume", tuple(legs), _end(legs, since), None, motion.skipped, speed=motion.speed))
        return True

    def skip(self, cycle: int) -> bool:
        """Skip to the next block, staying stopped if it was; return whether there was a block to skip."""
        motion, (since, speed, growth), row = self._now(cycle)
        if _past_skips(since, motion.skipped) >= self.programme.duration - CLOSE:
            return False
        legs, since, row = self._slowed(since, speed, growth, row)
        since = _past_skips(since, motion.skipped)
        spot = self.programme.spot(since)
        if spot.segment.leads:
            spot = self.programme.spot(spot.end)
        following = min(spot.end, self.programme.duration)
        done, then = (int(n) for n in self.programme.points(np.array([since, following])).load_cycles)
        skipped = (*motion.skipped, Skip(following, then - done))
        if motion.rests is not None:
            held = self._held(following)
            legs += self._way(row, following, held)
            self._add(Motion(cycle, "stop", tuple(legs), following, held, skipped, motion.reason, motion.speed))
            return True
        legs += self._way(row, following, self.programme.value(following))
        if motion.speed:
            legs.append(self._change(following, 0.0, 0.0, motion.speed))
        self._add(Motion(cycle, "skip", tuple(legs), _end(legs, following), None, skipped, speed=motion.speed))
        return True

    def pace(self, cycle: int, speed: float, reason: str = "") -> None:
        """Change the speed of the programme's time within the stop time, from a control cycle after all legs on."""
        motion, (since, now, growth), _ = self._now(cycle)
        leg = self._change(since, now, growth, speed)
        self._add(Motion(cycle, "pace", (leg,), _end([leg], since), None, motion.skipped, reason, speed))

    def run_to_reversal(self, cycle: int) -> None:
        """Run to the next reversal, if there is one, and wait there, from a control cycle after all legs on."""
        motion, (since, speed, _), _ = self._now(cycle)
        reversal = self.programme.reversal(since + 2.0 * SHORT)
        if reversal is None:
            if not speed:
                self.pace(cycle, 1.0)
            return
        to = reversal - SHORT
        # Not in a rest before the block: its time says nothing about the reversals.
        slowing = min(self._stop_time, EASING * (to - max(since, self.programme.spot(to).since)))
        # From a place between two reversals, the value would be accelerated more than by the programme.
        speeding = 0.0 if speed else self._stop_time if motion.kind == "resume" else slowing
        speed = speed or min(1.0, 2.0 * (to - since) / (speeding + slowing))
        ends = to - 0.5 * slowing * speed
        legs = [Leg(speeding, since, 0.0, 0.0, speed)] if speeding else []
        begins = _end(legs, since)
        if ends > begins:
            legs.append(Leg((ends - begins) / speed, begins, speed, 0.0, speed))
        legs.append(Leg(slowing, ends, speed, 0.0, 0.0))
        self._add(Motion(cycle, "pace", tuple(legs), to, None, motion.skipped, speed=0.0))

    def horizon(self, cycle: int, lead: int, min_lead: int) -> int:
        """Return the last control cycle to publish: not further ahead than necessary where the programme has to wait.

        Args:
            cycle: newest control cycle of the rig.
            lead: control cycles to publish ahead.
            min_lead: fewest control cycles to publish ahead.
        """
        motion = self.motions[-1]
        if motion.speed or motion.rests is not None:
            return cycle + lead
        return min(cycle + lead, max(self.arrival(), cycle + min_lead))

    def arrival(self) -> int:
        """Return the first control cycle after the legs of the last motion."""
        motion = self.motions[-1]
        return motion.first + math.ceil(sum(leg.duration for leg in motion.legs) / self._period)

    def forget(self, before: int) -> None:
        """Drop the motions that no control cycle from ``before`` on needs."""
        while len(self.motions) > 1 and self.motions[1].first <= before:
            del self.motions[0]

    def _add(self, motion: Motion) -> None:
        while self.motions and self.motions[-1].first >= motion.first:
            self.motions.pop()
        self.motions.append(motion)

    def _held(self, since: float) -> float:
        return self.programme.value(since) if self._hold is None else self._hold

    def _slowed(self, since: float, speed: float, growth: float, row: Row) -> tuple[list[Leg], float, Row]:
        """Return the leg to a standstill along the programme, none if stopped, with its final programme time and row."""
        if not speed:
            return [], since, row
        leg = self._change(since, speed, growth, 0.0)
        end = _end([leg], since)
        return [leg], end, (self.programme.value(end), 0.0, 0.0)

    def _change(self, since: float, speed: float, growth: float, to: float) -> Leg:
        """Return the leg from a speed of the programme's time, and its rate, to another speed."""
        duration = min(self._stop_time, STEEPEST / abs(growth)) if growth else self._stop_time
        return Leg(duration, since, speed, growth, to)

    def _way(self, row: Row, since: float, to: float) -> list[Leg]:
        """Return the leg from a row to rest at a value; none if it already rests there."""
        return [Leg(self._hold_time, since, row=row, to=to)] if row != (to, 0.0, 0.0) else []

    def _motion(self, cycle: int) -> Motion:
        firsts = [motion.first for motion in self.motions]
        return self.motions[max(int(np.searchsorted(firsts, cycle, side="right")) - 1, 0)]

    def _now(self, cycle: int) -> tuple[Motion, tuple[float, float, float], Row]:
        """Return the state of motion in a cycle: the motion, programme time with speed and its rate, and the row."""
        motion = self._motion(cycle)
        moving = self._moving(motion, np.array([cycle]))
        value, rate, bend = self._reference(moving)[0].tolist()
        return motion, (float(moving.since[0]), float(moving.speed[0]), float(moving.growth[0])), (value, rate, bend)

    def _fill(self, made: Rows, chosen: NDArray[np.intp], cycles: NDArray[np.int64], motion: Motion) -> None:
        moving = self._moving(motion, cycles[chosen])
        made.reference[chosen] = self._reference(moving)
        points = self.programme.points(moving.since)
        made.points.block[chosen] = points.block
        made.points.repetition[chosen] = points.repetition
        made.points.load_cycles[chosen] = points.load_cycles
        for skip in motion.skipped:
            made.points.load_cycles[chosen] -= np.where(moving.since >= skip.to - CLOSE, skip.load_cycles, 0)
        proceeds = (moving.speed > 0.0) | (moving.busy & (motion.kind == "pace"))
        made.points.phase[chosen] = np.where(proceeds, points.phase, np.nan)
        made.state[chosen] = self._states(motion, moving, cycles[chosen])

    def _states(self, motion: Motion, moving: Moving, cycles: NDArray[np.int64]) -> NDArray[np.int64]:
        under_way = {
            "start": State.STARTING,
            "stop": State.STOPPING,
            "resume": State.RESUMING,
            "skip": State.RESUMING,
            "pace": State.RUNNING,
        }[motion.kind]
        goes_on = State.RUNNING if motion.speed else State.WAITING
        arrived = goes_on if motion.rests is None else State.STOPPED
        state = np.where(moving.busy | (cycles < motion.first), under_way, arrived)
        return np.where((moving.since >= self.programme.duration - CLOSE) & ~moving.busy, State.FINISHED, state).astype(
            np.int64
        )

    def _reference(self, moving: Moving) -> Array:
        rows = self.programme.sample(moving.since)
        speed, growth = moving.speed, moving.growth
        # Chain rule for the programme as a function of its time.
        rows[:, 2] = rows[:, 2] * speed**2 + rows[:, 1] * growth
        rows[:, 1] *= speed
        off = ~np.isnan(moving.off[:, 0])
        rows[off] = moving.off[off]
        return rows

    def _moving(self, motion: Motion, cycles: NDArray[np.int64]) -> Moving:
        gone = np.maximum(cycles - motion.first, 0) * self._period
        n = cycles.size
        moving = Moving.empty(n)
        left = np.ones(n, np.bool_)
        for leg in motion.legs:
            now = left & (gone < leg.duration)
            _along(leg, gone[now], moving, now)
            moving.busy[now] = True
            left &= ~now
            gone = np.where(left, gone - leg.duration, gone)
        if motion.rests is None:
            moving.since[left] = motion.since + motion.speed * gone[left]
            # Before its first cycle it is stationary.
            moving.speed[left] = motion.speed * (cycles[left] >= motion.first)
        else:
            moving.since[left] = motion.since
            moving.off[left] = (motion.rests, 0.0, 0.0)
        return moving


def point_signals(parameters: Any, time: Array, period: float) -> dict[str, Array]:
    """Return the signals of an uninterrupted programme without pacing, by name as in ``programme_point``.

    Args:
        parameters: parameters of the programme.
        time: times of consecutive control cycles, shape (n,) [s].
        period: control period [s].
    """
    programme = programme_of(parameters)
    runner = Runner(programme, period, (Motion(0, "start", (), 0.0),))
    rows = runner.rows(round(float(time[0]) / period) if time.size else 0, time.size)
    points = rows.points
    return {
        "programme_block": points.block.astype(np.float64),
        "programme_repetition": points.repetition.astype(np.float64),
        "programme_load_cycles": points.load_cycles.astype(np.float64),
        "programme_phase": points.phase,
        "programme_state": rows.state.astype(np.float64),
    }


def along(leg: Leg, gone: Array) -> Moving:
    """Return the programme's motion in a leg at times since its beginning [s], shape (n,)."""
    moving = Moving.empty(gone.size)
    _along(leg, gone, moving, np.ones(gone.size, np.bool_))
    return moving


def _along(leg: Leg, gone: Array, moving: Moving, chosen: NDArray[np.bool_]) -> None:
    """Fill in the motion along a leg at times since its beginning [s]."""
    x = gone / leg.duration
    if leg.row is not None:
        moving.since[chosen] = leg.since
        moving.off[chosen] = _to_rest(leg.row, leg.to, leg.duration, x)
        return
    # Cubic Hermite polynomial for the speed; the time is its integral.
    a, b, c = leg.speed, leg.growth * leg.duration, leg.end_speed
    moving.since[chosen] = leg.since + leg.duration * _hermite_area(a, b, c, x)
    moving.speed[chosen] = a * (1.0 - 3.0 * x**2 + 2.0 * x**3) + b * (x - 2.0 * x**2 + x**3) + c * (3.0 * x**2 - 2.0 * x**3)
    slope = a * (6.0 * x**2 - 6.0 * x) + b * (1.0 - 4.0 * x + 3.0 * x**2) + c * (6.0 * x - 6.0 * x**2)
    moving.growth[chosen] = slope / leg.duration


def _hermite_area(a: float, b: float, c: float, x: Array) -> Array:
    return a * (x - x**3 + 0.5 * x**4) + b * (0.5 * x**2 - 2.0 / 3.0 * x**3 + 0.25 * x**4) + c * (x**3 - 0.5 * x**4)


def _past_skips(since: float, skipped: tuple[Skip, ...]) -> float:
    """Return a programme time, or the end of the last skipped block if it is not yet reached [s]."""
    return max([since, *(skip.to for skip in skipped)])


def _end(legs: Sequence[Leg], since: float) -> float:
    """Return the programme time at the end of legs, or another if there are none [s]."""
    if not legs:
        return since
    leg = legs[-1]
    if leg.row is not None:
        return leg.since
    return leg.since + leg.duration * float(_hermite_area(leg.speed, leg.growth * leg.duration, leg.end_speed, np.ones(1))[0])


def _to_rest(row: Row, to: float, duration: float, x: Array) -> Array:
    """Return the quintic from a value with its derivatives to rest at another value, shape (n, 3).

    Args:
        row: value, first and second derivative at the beginning.
        to: final value.
        duration: duration [s].
        x: fraction of the duration, shape (n,).
    """
    value, rate, bend = row[0], row[1] * duration, row[2] * duration**2
    way = to - value
    third = 10.0 * way - 6.0 * rate - 1.5 * bend
    fourth = -15.0 * way + 8.0 * rate + 1.5 * bend
    fifth = 6.0 * way - 3.0 * rate - 0.5 * bend
    polynomial = np.polynomial.Polynomial([value, rate, 0.5 * bend, third, fourth, fifth])
    first, second = polynomial.deriv(1), polynomial.deriv(2)
    return np.column_stack([polynomial(x), first(x) / duration, second(x) / duration**2])
